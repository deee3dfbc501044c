// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

namespace downpour {

// Values as the bytes that they are in memory, for processes of one program on machines of one
// kind.
class ByteWriter {
 public:
  template <typename T>
  void Put(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof(T));
  }
  // Number and elements of a vector, span or string.
  template <typename Range>
  void PutAll(const Range& values) {
    static_assert(std::is_trivially_copyable_v<typename Range::value_type>);
    Put(values.size());
    bytes_.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(values[0]));
  }
  std::string Take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

// Reads them in the order in which they were written. Throws std::runtime_error if there are not
// as many. `bytes` must outlive it.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  template <typename T>
  void Get(T* value) {
    static_assert(std::is_trivially_copyable_v<T>);
    Copy(sizeof(T), value);
  }
  template <typename T>
  T Get() {
    T value;
    Get(&value);
    return value;
  }
  template <typename Container>
  void GetAll(Container* values) {
    const auto n = Get<std::size_t>();
    if (n > bytes_.size()) throw std::runtime_error(kShort);
    values->resize(n);
    Copy(n * sizeof(typename Container::value_type), values->data());
  }
  std::string GetText() {
    std::string text;
    GetAll(&text);
    return text;
  }
  bool empty() const { return bytes_.empty(); }

 private:
  static constexpr const char* kShort = "a message between processes is too short";
  void Copy(std::size_t n, void* to) {
    if (n > bytes_.size()) throw std::runtime_error(kShort);
    if (n > 0) std::memcpy(to, bytes_.data(), n);
    bytes_.remove_prefix(n);
  }
  std::string_view bytes_;
};

}  // namespace downpour

// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/robot_system.h"

#include <cmath>
#include <optional>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/json_field.h"
#include "engine/learner/text_format.h"
#include "engine/robot/line_process.h"

namespace downpour {
namespace {

using Json = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

constexpr int kDeepest = 4;               // levels of a message; ours have two
constexpr double kFarewellTimeout = 0.1;  // s, for end and close, which have no answer
constexpr double kPartialTimeout = 0.1;   // s, for the rest of a line that nothing asked for
constexpr const char* kRobot = "the robot's answer";  // where JsonField says what it found

// What the program said, as a JSON string: printable, valid UTF-8, not long.
std::string Quoted(const std::string& text) {
  constexpr std::size_t kLongest = 80;
  const std::string part = text.size() > kLongest ? text.substr(0, kLongest) + "..." : text;
  return Json(part).dump(-1, ' ', false, Json::error_handler_t::replace);
}

class RobotSystem final : public System {
 public:
  RobotSystem(const Task& task, RobotOptions options)
      : task_(task), options_(std::move(options)), limits_(task.states.size(), kRobotLimit) {
    if (options_.step_timeout == 0) options_.step_timeout = 5 * task.control_period;
    Connect();
  }
  ~RobotSystem() override { Close(); }

  bool measured() const override { return true; }
  std::optional<double> reward() const override { return reward_; }
  bool done() const override { return done_; }

  void Reset(std::span<const double> state) override {
    std::vector<double> reached(state.size());
    Begin(1, state, reached);
  }

  void Begin(int episode, std::span<const double> start, std::span<double> state) override {
    if (process_ == nullptr) Connect();
    OrderedJson message = {{"type", "reset"}, {"episode", episode}};
    message["start"] = JsonNumbers({start.begin(), start.end()});
    step_ = 0;
    done_ = false;
    reward_.reset();
    Guarded([&] {
      const Json answer = Ask(message, "start", options_.setup_timeout);
      CheckEcho(answer, "episode", episode);
      ReadState(answer, state);
    });
  }

  void Step(std::span<const double> action, std::span<double> state) override {
    OrderedJson message = {{"type", "step"}, {"step", step_}};
    message["action"] = JsonNumbers({action.begin(), action.end()});
    Guarded([&] {
      const Json answer = Ask(message, "observation", options_.step_timeout);
      CheckEcho(answer, "step", step_);
      ReadState(answer, state);
      reward_.reset();
      if (answer.contains("reward")) reward_ = Checked(JsonField(answer, kRobot)["reward"]);
      done_ = answer.contains("done") && JsonField(answer, kRobot)["done"].Bool();
    });
    ++step_;
  }

  void End() noexcept override {
    if (process_ == nullptr) return;
    try {
      process_->WriteLine(R"({"type":"end"})", kFarewellTimeout);
    } catch (const std::exception&) {  // the next question finds out
    }
  }

 private:
  // Runs `exchange`; whatever goes wrong with the program's part of it ends the program first.
  template <typename Exchange>
  void Guarded(const Exchange& exchange) {
    try {
      exchange();
    } catch (const InvalidInput& error) {
      Close();
      throw SystemFailure(error.what());
    } catch (...) {
      Close();
      throw;
    }
  }

  void Connect() {
    try {
      process_ = std::make_unique<LineProcess>(options_.command, options_.stop);
      CheckHello(Ask(RobotHello(task_), "hello", options_.setup_timeout));
    } catch (...) {
      Close();
      throw;
    }
  }

  void Close() noexcept {
    if (process_ == nullptr) return;
    try {
      process_->WriteLine(R"({"type":"close"})", kFarewellTimeout);
    } catch (const std::exception&) {  // its input is closed next, which says the same
    }
    process_.reset();
  }

  // A line as an object. Throws SystemFailure if it is the program's own report of an error.
  static Json Message(const std::string& line) {
    Json message = ParseRobotLine(line);
    const JsonField field(message, kRobot);
    if (field["type"].String() == "error") {
      throw SystemFailure("the robot reports " + Quoted(field["message"].String()));
    }
    return message;
  }

  // Sends `question` and returns the answer, which must be of `type`.
  Json Ask(const OrderedJson& question, const char* type, double timeout) {
    if (process_ == nullptr) throw SystemFailure("the robot's program is not running");
    if (options_.stop != nullptr && *options_.stop) throw Interrupted();
    if (process_->HasOutput()) {
      const std::string line = process_->ReadLine(kPartialTimeout);
      static_cast<void>(Message(line));  // it may be the report of an error
      throw SystemFailure("the robot's program sent a line that nothing asked for: " +
                          Quoted(line));
    }
    process_->WriteLine(question.dump(), timeout);
    Json answer = Message(process_->ReadLine(timeout));
    const JsonField field = JsonField(answer, kRobot)["type"];
    if (field.String() != type) field.Fail(Quoted(type));
    return answer;
  }

  // An answer names what it answers, so that a line too many never passes for the next answer.
  static void CheckEcho(const Json& answer, const char* name, int value) {
    const JsonField field = JsonField(answer, kRobot)[name];
    if (field.value() != value) field.Fail(std::to_string(value));
  }

  static double Checked(const JsonField& field, double limit = kRobotLimit) {
    const double value = field.Number();
    if (!(std::abs(value) <= limit)) field.Fail("within +-" + FormatNumber(limit));  // NaN, too
    return value;
  }

  void ReadState(const Json& answer, std::span<double> state) const {
    const JsonField field = JsonField(answer, kRobot)["observation"];
    const std::vector<JsonField> items = field.Items();
    if (items.size() != state.size()) {
      field.Fail("an array of " + std::to_string(state.size()) + " numbers");
    }
    for (std::size_t i = 0; i < items.size(); ++i) state[i] = Checked(items[i], limits_[i]);
  }

  // Refuses a robot that is not the one of the task.
  void CheckHello(const Json& hello) {
    const JsonField root(hello, "the robot's hello");
    const auto check = [&](const char* name, int wanted, const std::string& why) {
      const JsonField field = root[name];
      if (field.value() != wanted) field.Fail(std::to_string(wanted) + ", " + why);
    };
    check("protocol", kRobotProtocol, "the version of the protocol");
    check("n_states", task_.n_states(), "as task " + task_.name + " has");
    check("n_actions", task_.n_actions(), "as task " + task_.name + " has");
    const JsonField period = root["control_period"];
    if (!(std::abs(period.Number() - task_.control_period) <= 1e-9 * task_.control_period)) {
      period.Fail(FormatNumber(task_.control_period) + " s, the task's control period");
    }
    const std::vector<JsonField> limits = Entries(root["action_limits"], task_.actions.size());
    for (std::size_t i = 0; i < limits.size(); ++i) {
      if (limits[i].Number() >= task_.action_limits[i]) continue;
      limits[i].Fail("at least " + FormatNumber(task_.action_limits[i]) + ", the task's limit of " +
                     task_.actions[i].name);
    }
    if (!hello.contains("observation_limits")) return;
    limits_.clear();
    for (const JsonField& limit : Entries(root["observation_limits"], task_.states.size())) {
      limits_.push_back(limit.Number());
      if (!(limits_.back() > 0 && limits_.back() <= kRobotLimit)) {
        limit.Fail("in (0, " + FormatNumber(kRobotLimit) + "]");
      }
    }
  }

  static std::vector<JsonField> Entries(const JsonField& field, std::size_t n) {
    std::vector<JsonField> items = field.Items();
    if (items.size() != n) field.Fail("an array of " + std::to_string(n) + " numbers");
    return items;
  }

  const Task task_;
  RobotOptions options_;
  std::vector<double> limits_;  // (E) of observations
  std::unique_ptr<LineProcess> process_;
  int step_ = 0;
  bool done_ = false;
  std::optional<double> reward_;
};

}  // namespace

nlohmann::ordered_json RobotHello(const Task& task) {
  OrderedJson hello = {{"type", "hello"}, {"protocol", kRobotProtocol}, {"task", task.name}};
  for (const Variable& state : task.states) {
    hello["states"].push_back({{"name", state.name}, {"unit", state.unit}});
  }
  for (int i = 0; i < task.n_actions(); ++i) {
    hello["actions"].push_back({{"name", task.actions[i].name},
                                {"unit", task.actions[i].unit},
                                {"limit", task.action_limits[i]}});
  }
  hello["control_period"] = task.control_period;
  hello["horizon"] = task.horizon;
  return hello;
}

nlohmann::json ParseRobotLine(const std::string& line) {
  bool deep = false;
  Json message;
  try {
    message = Json::parse(line, [&](int depth, Json::parse_event_t, Json&) {
      deep = deep || depth > kDeepest;
      return !deep;  // a value as deep as the line allows would overflow the stack when printed
    });
  } catch (const Json::exception&) {  // no JSON, or a number beyond the range of a double
    deep = true;
  }
  if (deep || !message.is_object()) {
    throw SystemFailure("the robot's program sent no message of the protocol: " + Quoted(line));
  }
  return message;
}

std::unique_ptr<System> MakeRobotSystem(const Task& task, const RobotOptions& options) {
  return std::make_unique<RobotSystem>(task, options);
}

}  // namespace downpour

// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/study_database.h"

#include <fmt/format.h>
#include <sqlite3.h>

#include <cmath>
#include <map>

#include "engine/errors.h"
#include "tools/measure/machine.h"

namespace downpour {
namespace {

constexpr int kApplication = 0x64707374;  // "dpst"
constexpr int kVersion = 1;
constexpr int kBusyMilliseconds = 60000;  // somebody may be reading

constexpr const char* kSchema = R"(
CREATE TABLE variant(            -- one variant on one task
  task TEXT NOT NULL,
  variant TEXT NOT NULL,
  position INTEGER NOT NULL,     -- in the study's file, from 0
  episodes INTEGER NOT NULL,     -- of a run at most, random ones included
  horizon INTEGER NOT NULL,      -- steps an episode
  control_period REAL NOT NULL,  -- s
  PRIMARY KEY(task, variant)
) WITHOUT ROWID;
CREATE TABLE setting(            -- what its results depend on
  task TEXT NOT NULL,
  variant TEXT NOT NULL,
  key TEXT NOT NULL,             -- as in a run's config.toml
  value TEXT NOT NULL,           -- as TOML
  PRIMARY KEY(task, variant, key)
) WITHOUT ROWID;
CREATE TABLE episode(            -- one finished episode of one replicate; no clock in it
  task TEXT NOT NULL,
  variant TEXT NOT NULL,
  seed INTEGER NOT NULL,
  episode INTEGER NOT NULL,      -- from 1
  random INTEGER NOT NULL,       -- 1: random actions
  real_return REAL NOT NULL,     -- on the system
  predicted_return REAL,         -- by the model; NULL: random
  solved INTEGER NOT NULL,       -- 1: this episode solved the task
  steps INTEGER NOT NULL,        -- on the system
  outcome TEXT NOT NULL,         -- complete, or how it was cut short
  interaction_seconds REAL NOT NULL,  -- on the system, this and all earlier episodes
  points INTEGER NOT NULL,       -- the model was learnt from
  evaluations INTEGER NOT NULL,  -- rollouts of the search
  gp_queries INTEGER NOT NULL,
  PRIMARY KEY(task, variant, seed, episode)
) WITHOUT ROWID;
CREATE TABLE timing(             -- the clock's part of the same episodes
  task TEXT NOT NULL,
  variant TEXT NOT NULL,
  seed INTEGER NOT NULL,
  episode INTEGER NOT NULL,
  model_seconds REAL NOT NULL,   -- learning the model
  search_seconds REAL NOT NULL,  -- searching the policy
  rollout_seconds REAL,          -- of them, rollouts; NULL: random
  threads INTEGER NOT NULL,      -- of the run
  jobs INTEGER NOT NULL,         -- runs side by side
  processor TEXT NOT NULL,
  simd_target TEXT NOT NULL,     -- of our kernels
  PRIMARY KEY(task, variant, seed, episode)
) WITHOUT ROWID;
CREATE VIEW run AS               -- one replicate
  SELECT task, variant, seed, count(*) AS episodes, max(real_return) AS best_return,
    min(CASE WHEN solved THEN episode END) AS solved_episode,
    min(CASE WHEN solved THEN interaction_seconds END) AS seconds_to_solve,
    total(model_seconds) AS model_seconds, total(search_seconds) AS search_seconds
  FROM episode JOIN timing USING(task, variant, seed, episode)
  GROUP BY task, variant, seed;
)";

// A statement and its values; what it throws names the file.
class Statement {
 public:
  Statement(sqlite3* database, const std::string& path, const char* sql)
      : database_(database), path_(path), statement_(nullptr, sqlite3_finalize) {
    sqlite3_stmt* statement = nullptr;
    Check(sqlite3_prepare_v2(database, sql, -1, &statement, nullptr));
    statement_.reset(statement);
  }

  template <typename... Values>
  Statement& Bind(const Values&... values) {
    int i = 0;
    (Check(BindOne(++i, values)), ...);
    return *this;
  }

  // True if there is a row.
  bool Step() {
    const int result = sqlite3_step(statement_.get());
    if (result != SQLITE_ROW && result != SQLITE_DONE) Check(result);
    return result == SQLITE_ROW;
  }

  int Int(int column) const { return sqlite3_column_int(statement_.get(), column); }
  std::string Text(int column) const {
    return reinterpret_cast<const char*>(sqlite3_column_text(statement_.get(), column));
  }

 private:
  void Check(int result) const {
    if (result != SQLITE_OK) throw FileError(path_ + ": " + sqlite3_errmsg(database_));
  }
  int BindOne(int i, const std::string& text) {
    return sqlite3_bind_text(statement_.get(), i, text.data(), static_cast<int>(text.size()),
                             SQLITE_TRANSIENT);
  }
  int BindOne(int i, double x) {  // NaN becomes NULL
    return sqlite3_bind_double(statement_.get(), i, x);
  }
  template <typename Integer>
  requires std::is_integral_v<Integer>
  int BindOne(int i, Integer x) {
    return sqlite3_bind_int64(statement_.get(), i, static_cast<sqlite3_int64>(x));
  }

  sqlite3* database_;
  std::string path_;
  std::unique_ptr<sqlite3_stmt, int (*)(sqlite3_stmt*)> statement_;
};

sqlite3* OpenDatabase(const std::string& path) {
  sqlite3* database = nullptr;
  const int result = sqlite3_open(path.c_str(), &database);
  if (result != SQLITE_OK) {
    const std::string reason = sqlite3_errmsg(database);
    sqlite3_close(database);
    throw FileError(fmt::format("{}: {}", path, reason));
  }
  return database;
}

}  // namespace

StudyDatabase::StudyDatabase(const std::string& path)
    : path_(path), database_(OpenDatabase(path), sqlite3_close) {
  sqlite3_busy_timeout(database_.get(), kBusyMilliseconds);
  Statement application(database_.get(), path_, "PRAGMA application_id");
  int id = 0, version = 0, tables = 0;
  try {
    id = application.Step() ? application.Int(0) : 0;
    Statement user(database_.get(), path_, "PRAGMA user_version");
    version = user.Step() ? user.Int(0) : 0;
    Statement count(database_.get(), path_, "SELECT count(*) FROM sqlite_master");
    tables = count.Step() ? count.Int(0) : 0;
  } catch (const FileError& error) {
    if (sqlite3_errcode(database_.get()) != SQLITE_NOTADB) throw;
    throw InvalidInput(fmt::format("{}: must be the database of a study or a new file", path_));
  }
  if (id == kApplication && version == kVersion) return;
  if (id != 0 || tables > 0) {
    throw InvalidInput(
        fmt::format("{}: must be the database of a study, of version {}, or a new "
                    "file",
                    path_, kVersion));
  }
  const std::string sql =
      fmt::format("BEGIN IMMEDIATE;{}PRAGMA application_id = {};PRAGMA user_version = {};COMMIT;",
                  kSchema, kApplication, kVersion);
  Execute(sql.c_str());
}

void StudyDatabase::Execute(const char* sql) {
  if (sqlite3_exec(database_.get(), sql, nullptr, nullptr, nullptr) == SQLITE_OK) return;
  const std::string reason = sqlite3_errmsg(database_.get());
  sqlite3_exec(database_.get(), "ROLLBACK", nullptr, nullptr, nullptr);
  throw FileError(fmt::format("{}: {}", path_, reason));
}

StudyDatabase::Progress StudyDatabase::ReadProgress(const StudyRun& run) {
  Statement statement(database_.get(), path_,
                      "SELECT count(*), min(CASE WHEN solved THEN episode END) FROM episode "
                      "WHERE task = ? AND variant = ? AND seed = ?");
  statement.Bind(run.variant->task, run.variant->name, run.seed).Step();
  return {statement.Int(0), statement.Int(1)};
}

void StudyDatabase::CheckVariant(const StudyVariant& variant) {
  Statement longest(database_.get(), path_,
                    "SELECT max(episode) FROM episode WHERE task = ? AND variant = ?");
  longest.Bind(variant.task, variant.name).Step();
  const int episodes = longest.Int(0);
  if (episodes == 0) return;
  const auto refuse = [&](const std::string& key, const std::string& now, const std::string& was) {
    throw InvalidInput(fmt::format(
        "{}: variant {} on {}: {} is {}, but {} has results with {}; must be as it was, or name a "
        "new variant",
        variant.origin, variant.name, variant.task, key, now, path_, was));
  };
  if (variant.config.learner.episodes < episodes) {
    refuse("learn.episodes", std::to_string(variant.config.learner.episodes),
           std::to_string(episodes));
  }
  std::map<std::string, std::string> settings = ResultSettings(variant.config);
  Statement saved(database_.get(), path_,
                  "SELECT key, value FROM setting WHERE task = ? AND variant = ?");
  saved.Bind(variant.task, variant.name);
  while (saved.Step()) {
    const std::string now = settings[saved.Text(0)];
    if (now != saved.Text(1)) refuse(saved.Text(0), now, saved.Text(1));
  }
}

void StudyDatabase::PutVariant(const StudyVariant& variant, int position) {
  Statement(database_.get(), path_, "INSERT OR REPLACE INTO variant VALUES(?, ?, ?, ?, ?, ?)")
      .Bind(variant.task, variant.name, position, variant.config.learner.episodes, variant.horizon,
            variant.control_period)
      .Step();
  Statement(database_.get(), path_, "DELETE FROM setting WHERE task = ? AND variant = ?")
      .Bind(variant.task, variant.name)
      .Step();
  for (const auto& [key, value] : ResultSettings(variant.config)) {
    Statement(database_.get(), path_, "INSERT INTO setting VALUES(?, ?, ?, ?)")
        .Bind(variant.task, variant.name, key, value)
        .Step();
  }
}

void StudyDatabase::Put(const Study& study) {
  for (const StudyVariant& variant : study.variants) CheckVariant(variant);
  Execute("BEGIN IMMEDIATE");
  int position = 0;
  for (const StudyVariant& variant : study.variants) PutVariant(variant, position++);
  Execute("COMMIT");
}

void StudyDatabase::Add(const StudyRun& run, const std::vector<EpisodeRecord>& episodes,
                        int threads, int jobs) {
  const std::string& task = run.variant->task;
  const std::string& variant = run.variant->name;
  const std::string processor = CpuModel();
  Execute("BEGIN IMMEDIATE");
  for (const EpisodeRecord& e : episodes) {
    Statement(database_.get(), path_,
              "INSERT OR IGNORE INTO episode VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
        .Bind(task, variant, run.seed, e.episode, e.random, e.real_return, e.predicted_return,
              e.solved, e.steps, e.outcome, e.interaction_seconds, e.points, e.evaluations,
              e.gp_queries)
        .Step();
    Statement(database_.get(), path_,
              "INSERT OR IGNORE INTO timing VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
        .Bind(task, variant, run.seed, e.episode, e.model_seconds, e.search_seconds,
              e.random ? std::nan("") : e.rollout_seconds, threads, jobs, processor,
              e.platform.simd_target)
        .Step();
  }
  Execute("COMMIT");
}

}  // namespace downpour

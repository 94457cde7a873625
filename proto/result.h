// proto/result.h - a value, or why there is none.
//
// Three kinds of wrong, three answers: the world is wrong (a packet, a file's bytes) -> a Result; we are wrong ->
// assert; the set-up is wrong (configuration, missing file, no permission) -> throw SetupError, caught once in main.
// The names are std::expected's, which g++ 12 has only as C++23; with a newer compiler this becomes an alias.
#pragma once

#include <cassert>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>

namespace csipose {

template <class Value, class Error>
class [[nodiscard]] Result {
 public:
  Result(Value value) : state_(std::in_place_index<0>, std::move(value)) {}
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}
  bool has_value() const { return state_.index() == 0; }
  explicit operator bool() const { return has_value(); }
  Value& operator*() {
    assert(has_value());
    return *std::get_if<0>(&state_);
  }
  const Value& operator*() const {
    assert(has_value());
    return *std::get_if<0>(&state_);
  }
  Value* operator->() { return &**this; }
  const Value* operator->() const { return &**this; }
  const Error& error() const {
    assert(!has_value());
    return *std::get_if<1>(&state_);
  }

 private:
  std::variant<Value, Error> state_;
};

/// Exit statuses of all our programs (sysexits.h where that has a name). Never 0 after a failure.
enum class ExitStatus : int {
  ok = 0,
  runtime = 1,
  usage = 64,
  bad_data = 65,
  no_input = 66,
  unavailable = 69,
  bug = 70,
  os_refusal = 71,
  cannot_create = 73,
  io = 74,
  try_again = 75,
  no_permission = 77,
  bad_config = 78
};

/// The set-up is wrong and a person must act. what() says what happened, to which thing, why and what to do, in one
/// or two sentences; main() prints it after the program's name and exits with `status`.
class SetupError : public std::runtime_error {
 public:
  SetupError(ExitStatus exit_status, const std::string& words)
      : std::runtime_error(words), status(exit_status) {}
  ExitStatus status;
};

}  // namespace csipose

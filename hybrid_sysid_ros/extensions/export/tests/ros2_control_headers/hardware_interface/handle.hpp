#pragma once
#include <optional>
#include <string>

namespace hardware_interface
{
struct CommandInterface
{
  CommandInterface(const std::string &, const std::string &, double * value) : value(value) {}
  double * value;
};

struct LoanedInterface
{
  double * value;
  std::optional<double> get_optional() const { return *value; }
  [[nodiscard]] bool set_value(double given)
  {
    *value = given;
    return true;
  }
};
}  // namespace hardware_interface

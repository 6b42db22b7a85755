// Drives a controller as a controller manager does: lines of a time, references and readings in, commands out.
#include <cstdio>
#include <cstdlib>

#include "controller_interface/chainable_controller_interface.hpp"

controller_interface::ChainableControllerInterface * made();

int main(int count, char ** arguments)
{
  using controller_interface::CallbackReturn;
  const int outputs = count > 3 ? std::atoi(arguments[1]) : 0, inputs = count > 3 ? std::atoi(arguments[2]) : 0;
  auto * controller = made();
  std::vector<double> readings(outputs), commands(inputs, 99.0);
  controller->update_rate = std::atoi(arguments[3]);
  for (auto & value : readings) controller->state_interfaces_.push_back({&value});
  for (auto & value : commands) controller->command_interfaces_.push_back({&value});
  if (
    controller->on_init() != CallbackReturn::SUCCESS || controller->on_configure({}) != CallbackReturn::SUCCESS ||
    controller->state_interface_configuration().names.size() != readings.size())
    return 1;
  auto references = controller->on_export_reference_interfaces();
  if (controller->on_activate({}) != CallbackReturn::SUCCESS) return 1;
  for (double time; std::scanf("%lf", &time) == 1;) {
    for (auto & reference : references)
      if (std::scanf("%lf", reference.value) != 1) return 1;
    for (auto & reading : readings)
      if (std::scanf("%lf", &reading) != 1) return 1;
    controller->update_reference_from_subscribers({time}, {});
    controller->update_and_write_commands({time}, {});
    for (const double command : commands) std::printf("%.17g ", command);
    std::printf("\n");
  }
  controller->on_deactivate({});
  for (const double command : commands) std::printf("%.17g ", command);
  delete controller;
  return 0;
}

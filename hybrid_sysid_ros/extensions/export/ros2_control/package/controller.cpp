// @title. Generated; do not edit.
#include "@{name}_controller/controller.hpp"

#include <cmath>
#include <limits>

#include "pluginlib/class_list_macros.hpp"

namespace @{name}_controller
{

using controller_interface::CallbackReturn;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

namespace
{
constexpr double PERIOD = @period;  // s
constexpr std::array<@{name}_real, @{NAME}_INPUTS> REST = {@rest};
constexpr std::array<const char *, @{NAME}_OUTPUTS> OUTPUTS = {@outputs};
}  // namespace

CallbackReturn Controller::on_init()
{
  try {
    parameter_listener_ = std::make_shared<ParamListener>(get_node());
    parameters_ = parameter_listener_->get_params();
    unit_ = std::make_unique<@{name}_memory>();
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "The controller can't begin: %s", error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  return {interface_configuration_type::INDIVIDUAL, parameters_.command_interfaces};
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
  return {interface_configuration_type::INDIVIDUAL, parameters_.state_interfaces};
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State &)
{
  parameters_ = parameter_listener_->get_params();
  const double rate = static_cast<double>(get_update_rate());
  if (std::abs(rate * PERIOD - 1.0) > 1e-3) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "update_rate is %g Hz, but the loop was exported for %g Hz: set update_rate to it.", rate,
      1.0 / PERIOD);
    return CallbackReturn::ERROR;
  }
  if (
    parameters_.state_interfaces.size() != @{NAME}_OUTPUTS || parameters_.command_interfaces.size() != @{NAME}_INPUTS)
  {
    RCLCPP_ERROR(
      get_node()->get_logger(), "The loop needs %d state interfaces and %d command interfaces.", @{NAME}_OUTPUTS,
      @{NAME}_INPUTS);
    return CallbackReturn::ERROR;
  }
  if (!@{name}_init(unit_.get())) {
    RCLCPP_ERROR(get_node()->get_logger(), "The memory of the solver is too small.");
    return CallbackReturn::ERROR;
  }
  subscription_ = get_node()->create_subscription<Reference>(
    "~/reference", rclcpp::SystemDefaultsQoS(), [this](const std::shared_ptr<Reference> message) {
      const auto size = message->data.size();
      if (size != @{NAME}_OUTPUTS && size != @{NAME}_HORIZON * @{NAME}_OUTPUTS) {
        RCLCPP_WARN(
          get_node()->get_logger(), "A reference has %zu numbers: it needs %d, or %d of a preview.", size,
          @{NAME}_OUTPUTS, @{NAME}_HORIZON * @{NAME}_OUTPUTS);
        return;
      }
      received_.writeFromNonRT(message);
    });
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State &)
{
  @{name}_reset(unit_.get());
  for (std::size_t j = 0; j < REST.size(); j++) {
    command_.inputs[j] = REST[j];
  }
  @{name}_sent(unit_.get(), command_.inputs);
  referred_ = false;
  received_.writeFromNonRT(nullptr);
  reference_interfaces_.assign(reference_interfaces_.size(), std::numeric_limits<double>::quiet_NaN());
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State &)
{
  write(REST.data());
  return CallbackReturn::SUCCESS;
}

std::vector<hardware_interface::CommandInterface> Controller::on_export_reference_interfaces()
{
  reference_interfaces_.assign(@{NAME}_OUTPUTS, std::numeric_limits<double>::quiet_NaN());
  std::vector<hardware_interface::CommandInterface> exported;
  exported.reserve(@{NAME}_OUTPUTS);
  for (std::size_t k = 0; k < OUTPUTS.size(); k++) {
    exported.emplace_back(get_node()->get_name(), OUTPUTS[k], &reference_interfaces_[k]);
  }
  return exported;
}

bool Controller::on_set_chained_mode(bool)
{
  return true;
}

return_type Controller::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &)
{
  const auto message = *received_.readFromRT();
  if (message) {
    for (std::size_t k = 0; k < @{NAME}_HORIZON * @{NAME}_OUTPUTS; k++) {
      reference_.outputs[k] = static_cast<@{name}_real>(message->data[k % message->data.size()]);
    }
    referred_ = true;
  }
  return return_type::OK;
}

return_type Controller::update_and_write_commands(const rclcpp::Time & time, const rclcpp::Duration &)
{
  @{name}_measurement measurement;
  measurement.time = time.seconds();
  for (std::size_t k = 0; k < OUTPUTS.size(); k++) {
    // While its driver writes it a reading may be nothing: then it is a missing one.
    const auto reading = state_interfaces_[k].get_optional();
    measurement.outputs[k] = static_cast<@{name}_real>(reading.value_or(std::numeric_limits<double>::quiet_NaN()));
  }
  for (std::size_t j = 0; j < REST.size(); j++) {
    measurement.applied[j] = command_.inputs[j];
  }
  for (std::size_t k = 0; k < OUTPUTS.size(); k++) {
    // A chained reference holds over the horizon. Until there is one, the first reading is the reference.
    const double chained = is_in_chained_mode() ? reference_interfaces_[k] : std::numeric_limits<double>::quiet_NaN();
    const double first = std::isfinite(measurement.outputs[k]) ? measurement.outputs[k] : reference_.outputs[k];
    if (std::isfinite(chained) || !referred_) {
      for (std::size_t i = 0; i < @{NAME}_HORIZON; i++) {
        reference_.outputs[i * OUTPUTS.size() + k] =
          static_cast<@{name}_real>(std::isfinite(chained) ? chained : first);
      }
    }
  }
  referred_ = true;
  @{name}_step(unit_.get(), &measurement, &reference_, &command_);
  write(command_.inputs);
  @{name}_prepare(unit_.get(), PERIOD);
  return return_type::OK;
}

void Controller::write(const @{name}_real * inputs)
{
  for (std::size_t j = 0; j < command_interfaces_.size(); j++) {
    (void)command_interfaces_[j].set_value(static_cast<double>(inputs[j]));
  }
}

}  // namespace @{name}_controller

PLUGINLIB_EXPORT_CLASS(@{name}_controller::Controller, controller_interface::ChainableControllerInterface)

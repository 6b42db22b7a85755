// @title. Generated; do not edit.
#ifndef @{NAME}_CONTROLLER__CONTROLLER_HPP_
#define @{NAME}_CONTROLLER__CONTROLLER_HPP_

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "hardware_interface/handle.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "realtime_tools/realtime_buffer.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

#include "@{name}_controller_parameters.hpp"

#include "@name.h"

namespace @{name}_controller
{

// Estimator and controller in one. Its reference is held over the horizon, or comes as a preview by a topic.
class Controller : public controller_interface::ChainableControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & previous_state) override;
  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & previous_state) override;
  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous_state) override;
  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

protected:
  using Reference = std_msgs::msg::Float64MultiArray;

  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
  bool on_set_chained_mode(bool chained_mode) override;
  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  void write(const @{name}_real * inputs);

  std::shared_ptr<ParamListener> parameter_listener_;
  Params parameters_;
  rclcpp::Subscription<Reference>::SharedPtr subscription_;
  realtime_tools::RealtimeBuffer<std::shared_ptr<Reference>> received_;
  std::unique_ptr<@{name}_memory> unit_;  // its addresses are within it: it must not move
  @{name}_reference reference_{};
  @{name}_command command_{};
  bool referred_ = false;  // whether there has been a reference since the activation
};

}  // namespace @{name}_controller

#endif  // @{NAME}_CONTROLLER__CONTROLLER_HPP_

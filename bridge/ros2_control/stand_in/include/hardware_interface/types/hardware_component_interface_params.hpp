// A stand-in of hardware_interface: see stand_in/README.md.
#ifndef MOTORD_STAND_IN_HARDWARE_COMPONENT_INTERFACE_PARAMS_HPP
#define MOTORD_STAND_IN_HARDWARE_COMPONENT_INTERFACE_PARAMS_HPP

#include "hardware_interface/hardware_info.hpp"
#include "rclcpp/rclcpp.hpp"

namespace hardware_interface {

struct HardwareComponentInterfaceParams {
    HardwareInfo hardware_info;
    rclcpp::Executor::WeakPtr executor;
};

} // namespace hardware_interface

#endif

/// @file
/// A group of motord as a system of ros2_control. Values are SI, joint side: rad, rad/s, N·m, N·m/rad, N·m·s/rad, °C.

#ifndef MOTORD_HARDWARE__MOTORD_SYSTEM_HPP_
#define MOTORD_HARDWARE__MOTORD_SYSTEM_HPP_

#include <array>
#include <chrono>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include <motord.hpp>

#include "hardware_interface/system_interface.hpp"
#include "hardware_interface/types/hardware_component_interface_params.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "motord_hardware/command.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"

namespace motord_hardware {

/// The settings of the hardware, from the `<param>` of its `<hardware>` in the URDF.
struct Settings {
    std::string instance = "robot"; ///< The instance of motord.
    std::string group = "legs";     ///< Its group, whose joints are all in the URDF.
    double kp = 20.0;               ///< Stiffness of a joint without the command interface `stiffness`, N·m/rad.
    double kd = 0.5;                ///< Damping of a joint without the command interface `damping`, N·m·s/rad.
    double horizon_ms = 0.0;        ///< Time from a command to its position, ms; 0: immediately.
    double state_timeout_ms = 100.0; ///< Oldest state that is no error, ms.
};

/// Inactive: reads states, owns nothing. Active: owns the group, whose motors are enabled.
///
/// Activation never resets a stop. A stop by motord is an error of the hardware, which ends unconfigured and released.
class MotordSystem : public hardware_interface::SystemInterface {
public:
    using CallbackReturn = hardware_interface::CallbackReturn;
    using return_type = hardware_interface::return_type;

    /// Checks parameters and interfaces of the URDF. Contacts no daemon.
    CallbackReturn on_init(const hardware_interface::HardwareComponentInterfaceParams &params) override;
    /// Connects. FAILURE, which may be tried again, without a daemon, or where its joints are others.
    CallbackReturn on_configure(const rclcpp_lifecycle::State &previous) override;
    /// Claims the group and enables its motors where they are: the first commands are the measured positions.
    CallbackReturn on_activate(const rclcpp_lifecycle::State &previous) override;
    /// Damps and stops the motors, and releases the group.
    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &previous) override;
    /// Disconnects.
    CallbackReturn on_cleanup(const rclcpp_lifecycle::State &previous) override;
    /// As `on_deactivate` and `on_cleanup`.
    CallbackReturn on_shutdown(const rclcpp_lifecycle::State &previous) override;
    /// Releases the group, whose motors are damped and stopped, and disconnects.
    CallbackReturn on_error(const rclcpp_lifecycle::State &previous) override;

    /// Records which command interfaces have a controller. Those that lose theirs get a command that moves nothing.
    return_type perform_command_mode_switch(const std::vector<std::string> &start,
                                            const std::vector<std::string> &stop) override;
    /// Reads the newest state without waiting. ERROR once it is too old, or the group of an active hardware is stopped.
    return_type read(const rclcpp::Time &time, const rclcpp::Duration &period) override;
    /// Sends a setpoint for each joint without waiting. ERROR once the group is stopped.
    return_type write(const rclcpp::Time &time, const rclcpp::Duration &period) override;

private:
    /// A joint of the URDF.
    struct Joint {
        std::string name;            ///< In the URDF.
        std::string motord_name;     ///< In motord: its parameter `motord_joint`, or the same.
        CommandNames command;        ///< Full names of its command interfaces; empty for one that it lacks.
        StateNames state;            ///< Full names of its state interfaces; empty for one that it lacks.
        std::size_t robot_index = 0; ///< In the robot.
        std::size_t claim_index = 0; ///< In the arrays of the claim.
        Controlled controlled;       ///< Interfaces that have a controller.
        double position = 0.0;       ///< Last measured position, rad.
        double held = 0.0;           ///< Position that is held without a command, rad.
    };
    /// An IMU of the URDF.
    struct Imu {
        std::string name;                     ///< In motord: the parameter `motord_imu` of the sensor, or its name.
        std::vector<std::string> state_names; ///< Full names, in the order of imu_interfaces(); empty for one that it lacks.
        std::size_t robot_index = 0;          ///< In the robot.
    };

    void read_description();
    void connect();
    void start();
    void publish_state();
    void publish_imu(const Imu &imu);
    std::array<double, COMMANDS> neutral(const Joint &joint) const noexcept;
    void release() noexcept;
    bool report(const char *action, motord_status status);

    Settings settings_;
    std::vector<Joint> joints_;
    std::vector<Imu> imus_;
    std::unique_ptr<motord::Client> client_;
    std::unique_ptr<motord::State> state_;
    std::unique_ptr<motord::Claim> claim_;
    /// Setpoints in the order of the claim.
    std::vector<double> position_, velocity_, kp_, kd_, torque_;
    std::chrono::steady_clock::time_point last_state_;
};

} // namespace motord_hardware

#endif // MOTORD_HARDWARE__MOTORD_SYSTEM_HPP_

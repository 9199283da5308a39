/// @file
/// Which command interfaces a joint has, which of them a controller writes, and the setpoint that follows.

#ifndef MOTORD_HARDWARE__COMMAND_HPP_
#define MOTORD_HARDWARE__COMMAND_HPP_

#include <array>
#include <cmath>
#include <cstddef>
#include <string>

namespace motord_hardware {

/// Command interfaces of a joint, in the order of the arrays below.
enum Command : std::size_t { POSITION, VELOCITY, EFFORT, STIFFNESS, DAMPING, COMMANDS };
/// Their names.
inline constexpr std::array<const char *, COMMANDS> COMMAND_INTERFACES = {"position", "velocity", "effort", "stiffness",
                                                                         "damping"};
/// State interfaces of a joint: position, velocity, effort, temperature.
inline constexpr std::array<const char *, 4> STATE_INTERFACES = {"position", "velocity", "effort", "temperature"};

/// Full names, such as `knee/position`; empty for an interface that the URDF lacks.
using CommandNames = std::array<std::string, COMMANDS>;
/// As CommandNames, of the states.
using StateNames = std::array<std::string, STATE_INTERFACES.size()>;
/// The interfaces that a controller has claimed.
using Controlled = std::array<bool, COMMANDS>;

/// A setpoint of a joint: rad, rad/s, N·m, N·m/rad, N·m·s/rad.
struct Setpoint {
    double position, velocity, effort, kp, kd;
};

/// A joint with stiffness: its position has a controller, or nothing has.
inline bool has_position(const Controlled &controlled) noexcept {
    return controlled[POSITION] || !(controlled[VELOCITY] || controlled[EFFORT]);
}

/// The setpoint of the commands that controllers wrote. A value that is not finite is no command.
///
/// Without a controller the joint holds `held`. A controller of the effort alone, or of velocity and effort, gets a joint without
/// stiffness; one of the effort alone also without damping; unless `stiffness` or `damping` has a controller itself.
inline Setpoint setpoint(const std::array<double, COMMANDS> &written, const Controlled &controlled, double held, double kp,
                         double kd) noexcept {
    const auto value = [&](Command command, double otherwise) {
        return controlled[command] && std::isfinite(written[command]) ? written[command] : otherwise;
    };
    const bool is_stiff = has_position(controlled), is_damped = is_stiff || controlled[VELOCITY];
    return {value(POSITION, held), value(VELOCITY, 0.0), value(EFFORT, 0.0), value(STIFFNESS, is_stiff ? kp : 0.0),
            value(DAMPING, is_damped ? kd : 0.0)};
}

} // namespace motord_hardware

#endif // MOTORD_HARDWARE__COMMAND_HPP_

// A stand-in of rclcpp_lifecycle: see stand_in/README.md.
#ifndef MOTORD_STAND_IN_STATE_HPP
#define MOTORD_STAND_IN_STATE_HPP

#include <cstdint>
#include <string>

namespace lifecycle_msgs::msg {

struct State {
    static constexpr std::uint8_t PRIMARY_STATE_UNKNOWN = 0;
    static constexpr std::uint8_t PRIMARY_STATE_UNCONFIGURED = 1;
    static constexpr std::uint8_t PRIMARY_STATE_INACTIVE = 2;
    static constexpr std::uint8_t PRIMARY_STATE_ACTIVE = 3;
    static constexpr std::uint8_t PRIMARY_STATE_FINALIZED = 4;
};

} // namespace lifecycle_msgs::msg

namespace rclcpp_lifecycle {

class State {
public:
    State(std::uint8_t id, std::string label) : id_(id), label_(std::move(label)) {}
    std::uint8_t id() const { return id_; }
    const std::string &label() const { return label_; }

private:
    std::uint8_t id_;
    std::string label_;
};

} // namespace rclcpp_lifecycle

#endif

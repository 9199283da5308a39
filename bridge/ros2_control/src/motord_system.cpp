#include "motord_hardware/motord_system.hpp"

#include <algorithm>
#include <exception>
#include <stdexcept>
#include <utility>

#include "pluginlib/class_list_macros.hpp"

namespace motord_hardware {

namespace {

using namespace std::chrono_literals;

/// State interfaces of an IMU, as the IMU sensor broadcaster names them.
constexpr std::array<const char *, 10> IMU_INTERFACES = {
    "orientation.x",         "orientation.y",         "orientation.z",         "orientation.w",        "angular_velocity.x",
    "angular_velocity.y",    "angular_velocity.z",    "linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"};

/// A number of the URDF. Throws std::invalid_argument for one that is none, not finite, or negative.
double number(const std::string &name, const std::string &text) {
    std::size_t end = 0;
    double value = -1.0;
    try {
        value = std::stod(text, &end);
    } catch (const std::exception &) {
        end = 0;
    }
    if (end != text.size() || text.empty() || !std::isfinite(value) || value < 0.0)
        throw std::invalid_argument(name + " is \"" + text + "\": it must be a finite number that is not negative");
    return value;
}

/// Fills the full names of the interfaces that `infos` has. Throws std::invalid_argument for one that is not in `known`.
template <std::size_t Count, typename Names>
void name_interfaces(const std::string &owner, const std::vector<hardware_interface::InterfaceInfo> &infos,
                     const std::array<const char *, Count> &known, Names &names) {
    for (const auto &info : infos) {
        const auto found = std::find(known.begin(), known.end(), info.name);
        if (found == known.end()) {
            std::string list;
            for (const char *each : known)
                list += (list.empty() ? "" : ", ") + std::string(each);
            throw std::invalid_argument(owner + " has the interface " + info.name + "; motord knows " + list);
        }
        names[static_cast<std::size_t>(found - known.begin())] = owner + "/" + info.name;
    }
}

std::string parameter(const hardware_interface::ComponentInfo &info, const char *name) {
    const auto found = info.parameters.find(name);
    return found == info.parameters.end() ? info.name : found->second;
}

motord::Nanoseconds milliseconds(double time) {
    return std::chrono::duration_cast<motord::Nanoseconds>(std::chrono::duration<double, std::milli>(time));
}

} // namespace

MotordSystem::CallbackReturn MotordSystem::on_init(const hardware_interface::HardwareComponentInterfaceParams &params) {
    if (hardware_interface::SystemInterface::on_init(params) != CallbackReturn::SUCCESS)
        return CallbackReturn::ERROR;
    try {
        read_description();
        return CallbackReturn::SUCCESS;
    } catch (const std::invalid_argument &error) {
        RCLCPP_ERROR(get_logger(), "%s", error.what());
        return CallbackReturn::ERROR;
    }
}

void MotordSystem::read_description() {
    const auto &given = info_.hardware_parameters;
    const auto text = [&given](const char *name, std::string &value) {
        if (const auto found = given.find(name); found != given.end())
            value = found->second;
    };
    const auto value = [&given](const char *name, double &target) {
        if (const auto found = given.find(name); found != given.end())
            target = number(name, found->second);
    };
    settings_ = Settings{};
    text("instance", settings_.instance);
    text("group", settings_.group);
    value("kp", settings_.kp);
    value("kd", settings_.kd);
    value("horizon_ms", settings_.horizon_ms);
    value("state_timeout_ms", settings_.state_timeout_ms);
    joints_.clear();
    imus_.clear();
    for (const auto &info : info_.joints) {
        Joint joint;
        joint.name = info.name;
        joint.motord_name = parameter(info, "motord_joint");
        name_interfaces(info.name, info.command_interfaces, COMMAND_INTERFACES, joint.command);
        name_interfaces(info.name, info.state_interfaces, STATE_INTERFACES, joint.state);
        joints_.push_back(std::move(joint));
    }
    for (const auto &info : info_.sensors) {
        Imu imu;
        imu.name = parameter(info, "motord_imu");
        imu.state_names.resize(IMU_INTERFACES.size());
        name_interfaces(info.name, info.state_interfaces, IMU_INTERFACES, imu.state_names);
        imus_.push_back(std::move(imu));
    }
}

MotordSystem::CallbackReturn MotordSystem::on_configure(const rclcpp_lifecycle::State &) {
    try {
        connect();
        return CallbackReturn::SUCCESS;
    } catch (const std::exception &error) {
        RCLCPP_ERROR(get_logger(), "cannot connect to %s: %s", settings_.instance.c_str(), error.what());
        release();
        client_.reset();
        return CallbackReturn::FAILURE;
    }
}

void MotordSystem::connect() {
    client_ = std::make_unique<motord::Client>(settings_.instance);
    state_ = std::make_unique<motord::State>();
    for (Joint &joint : joints_) {
        joint.robot_index = client_->joint(joint.motord_name);
        joint.controlled = {};
        const auto limits = client_->limits(joint.robot_index);
        if (settings_.kp > limits.kp || settings_.kd > limits.kd)
            throw std::invalid_argument("kp or kd of " + joint.name + " is above the limit of motord");
    }
    for (Imu &imu : imus_)
        imu.robot_index = client_->imu(imu.name);
    client_->wait(*state_);
    last_state_ = std::chrono::steady_clock::now();
    publish_state();
}

MotordSystem::CallbackReturn MotordSystem::on_activate(const rclcpp_lifecycle::State &) {
    try {
        start();
        return CallbackReturn::SUCCESS;
    } catch (const std::exception &error) {
        RCLCPP_ERROR(get_logger(), "cannot activate %s: %s", settings_.group.c_str(), error.what());
        release();
        return CallbackReturn::FAILURE;
    }
}

void MotordSystem::start() {
    claim_ = std::make_unique<motord::Claim>(*client_, settings_.group);
    std::vector<std::string> names;
    for (const Joint &joint : joints_)
        names.push_back(joint.motord_name);
    const auto indices = claim_->indices(*client_, names);
    for (std::size_t index = 0; index < joints_.size(); ++index)
        joints_[index].claim_index = indices[index];
    for (auto *values : {&position_, &velocity_, &kp_, &kd_, &torque_})
        values->assign(claim_->size(), 0.0);
    // A controller that left a moment ago is still damped.
    claim_->wait_for(MOTORD_PHASE_DISARMED);
    client_->wait(*state_);
    publish_state();
    claim_->hold(*state_, settings_.kp, settings_.kd);
    claim_->commit();
    claim_->enable();
    claim_->wait_for(MOTORD_PHASE_ACTIVE);
    claim_->set_horizon(milliseconds(settings_.horizon_ms));
    last_state_ = std::chrono::steady_clock::now();
    for (Joint &joint : joints_) {
        // The position that the daemon holds: one that sagged since must not become the command.
        joint.held = joint.position;
        const auto values = neutral(joint);
        for (std::size_t command = 0; command < COMMANDS; ++command)
            if (!joint.command[command].empty())
                set_command(joint.command[command], values[command]);
    }
}

/// The commands that move nothing: the held position, no velocity, no effort, the gains of the settings.
std::array<double, COMMANDS> MotordSystem::neutral(const Joint &joint) const noexcept {
    return {joint.held, 0.0, 0.0, settings_.kp, settings_.kd};
}

MotordSystem::CallbackReturn MotordSystem::on_deactivate(const rclcpp_lifecycle::State &) {
    if (!claim_)
        return CallbackReturn::SUCCESS;
    try {
        claim_->disable();
        claim_->wait_for(MOTORD_PHASE_DISARMED);
        claim_->release();
    } catch (const std::exception &error) {
        // The end of the claim releases the group; without a daemon the dead man's switch damps.
        RCLCPP_ERROR(get_logger(), "motord did not confirm the stop of %s: %s", settings_.group.c_str(), error.what());
        release();
        return CallbackReturn::ERROR;
    }
    release();
    return CallbackReturn::SUCCESS;
}

MotordSystem::CallbackReturn MotordSystem::on_cleanup(const rclcpp_lifecycle::State &) {
    release();
    state_.reset();
    client_.reset();
    return CallbackReturn::SUCCESS;
}

MotordSystem::CallbackReturn MotordSystem::on_shutdown(const rclcpp_lifecycle::State &previous) {
    const auto stopped = on_deactivate(previous);
    on_cleanup(previous);
    return stopped;
}

MotordSystem::CallbackReturn MotordSystem::on_error(const rclcpp_lifecycle::State &previous) { return on_cleanup(previous); }

void MotordSystem::release() noexcept {
    claim_.reset();
    for (Joint &joint : joints_)
        joint.controlled = {};
}

MotordSystem::return_type MotordSystem::perform_command_mode_switch(const std::vector<std::string> &start,
                                                                    const std::vector<std::string> &stop) {
    // The lists contain interfaces of other hardware, too.
    const auto each = [this](const std::vector<std::string> &names, const auto &change) {
        for (const std::string &name : names)
            for (Joint &joint : joints_)
                for (std::size_t command = 0; command < COMMANDS; ++command)
                    if (!joint.command[command].empty() && joint.command[command] == name)
                        change(joint, command);
    };
    each(stop, [this](Joint &joint, std::size_t command) {
        // A joint without stiffness has moved since its last position.
        if (!has_position(joint.controlled))
            joint.held = joint.position;
        // The last command of a controller that left must not live on.
        if (claim_)
            set_command(joint.command[command], neutral(joint)[command]);
    });
    each(stop, [](Joint &joint, std::size_t command) { joint.controlled[command] = false; });
    each(start, [](Joint &joint, std::size_t command) { joint.controlled[command] = true; });
    return return_type::OK;
}

MotordSystem::return_type MotordSystem::read(const rclcpp::Time &, const rclcpp::Duration &) {
    if (!client_)
        return return_type::OK;
    bool is_new = false;
    if (!report("read", client_->try_newest(*state_, is_new)))
        return return_type::ERROR;
    const auto now = std::chrono::steady_clock::now();
    if (is_new) {
        last_state_ = now;
        publish_state();
    } else if (now - last_state_ > milliseconds(settings_.state_timeout_ms)) {
        RCLCPP_ERROR(get_logger(), "motord published no state for %g ms", settings_.state_timeout_ms);
        return return_type::ERROR;
    }
    if (claim_ && !report("hold", claim_->try_must_be_active(*state_)))
        return return_type::ERROR;
    return return_type::OK;
}

void MotordSystem::publish_state() {
    for (Joint &joint : joints_) {
        motord_joint read{};
        if (state_->try_joint(joint.robot_index, read) != MOTORD_STATUS_OK)
            continue;
        if (std::isfinite(read.position))
            joint.position = read.position;
        const std::array<double, STATE_INTERFACES.size()> values = {read.position, read.velocity, read.torque, read.temperature};
        for (std::size_t index = 0; index < values.size(); ++index)
            if (!joint.state[index].empty())
                set_state(joint.state[index], values[index]);
    }
    for (const Imu &imu : imus_)
        publish_imu(imu);
}

void MotordSystem::publish_imu(const Imu &imu) {
    motord_imu read{};
    if (motord_state_imu(state_->get(), imu.robot_index, &read) != MOTORD_STATUS_OK)
        return;
    // ROS has w last. A lost IMU has no orientation.
    const double unknown = std::nan("");
    const auto *turn = read.orientation, *rate = read.angular_velocity, *force = read.acceleration;
    const std::array<double, IMU_INTERFACES.size()> values = {turn[1], turn[2], turn[3],  turn[0],  rate[0],
                                                              rate[1], rate[2], force[0], force[1], force[2]};
    for (std::size_t index = 0; index < values.size(); ++index)
        if (!imu.state_names[index].empty())
            set_state(imu.state_names[index], read.lost ? unknown : values[index]);
}

MotordSystem::return_type MotordSystem::write(const rclcpp::Time &, const rclcpp::Duration &) {
    if (!claim_)
        return return_type::OK;
    for (Joint &joint : joints_) {
        std::array<double, COMMANDS> written{};
        for (std::size_t command = 0; command < COMMANDS; ++command)
            written[command] = joint.command[command].empty() ? std::nan("") : get_command(joint.command[command]);
        const Setpoint next = setpoint(written, joint.controlled, joint.held, settings_.kp, settings_.kd);
        // A position without a command any more holds where the last one was.
        joint.held = next.position;
        position_[joint.claim_index] = next.position;
        velocity_[joint.claim_index] = next.velocity;
        torque_[joint.claim_index] = next.effort;
        kp_[joint.claim_index] = next.kp;
        kd_[joint.claim_index] = next.kd;
    }
    const motord::Setpoints setpoints{position_.data(), velocity_.data(), kp_.data(), kd_.data(), torque_.data()};
    return report("command", claim_->try_send(setpoints, position_.size())) ? return_type::OK : return_type::ERROR;
}

/// Logs the sentence of the daemon for a failure. Returns whether there is none.
bool MotordSystem::report(const char *action, motord_status status) {
    if (status == MOTORD_STATUS_OK)
        return true;
    RCLCPP_ERROR(get_logger(), "cannot %s %s: %s", action, settings_.group.c_str(), motord_error_message());
    return false;
}

} // namespace motord_hardware

PLUGINLIB_EXPORT_CLASS(motord_hardware::MotordSystem, hardware_interface::SystemInterface)

// The plug-in beside a daemon with twelve simulated motors, driven as the controller manager of ros2_control drives it: its transitions
// are those of hardware_component.cpp. Compiled against stand_in/, not against ros2_control.
//
//   system_test SCENARIO    status 0: the property holds

#include "motord_hardware/motord_system.hpp"

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <thread>

namespace {

using namespace std::chrono_literals;
using hardware_interface::CallbackReturn;
using hardware_interface::return_type;
using motord_hardware::MotordSystem;
using Id = lifecycle_msgs::msg::State;

const char *const JOINTS[] = {"fl-hip", "fl-thigh", "fl-knee", "fr-hip", "fr-thigh", "fr-knee",
                              "rl-hip", "rl-thigh", "rl-knee", "rr-hip", "rr-thigh", "rr-knee"};

#define CHECK(condition)                                                                                                       \
    do {                                                                                                                       \
        if (!(condition)) {                                                                                                    \
            std::fprintf(stderr, "%s:%d: %s does not hold\n", __FILE__, __LINE__, #condition);                                 \
            std::exit(EXIT_FAILURE);                                                                                           \
        }                                                                                                                      \
    } while (false)

/// The hardware of a URDF: its joints in reverse order, since that need not be motord's.
hardware_interface::HardwareInfo description() {
    hardware_interface::HardwareInfo info;
    info.name = "quadruped";
    info.type = "system";
    info.hardware_plugin_name = "motord_hardware/MotordSystem";
    info.hardware_parameters = {{"instance", "demo"}, {"group", "legs"}, {"kp", "40.0"}, {"kd", "1.0"}};
    for (std::size_t index = std::size(JOINTS); index-- > 0;) {
        hardware_interface::ComponentInfo joint;
        joint.name = JOINTS[index];
        for (const char *name : motord_hardware::COMMAND_INTERFACES) {
            joint.command_interfaces.emplace_back();
            joint.command_interfaces.back().name = name;
        }
        for (const char *name : motord_hardware::STATE_INTERFACES) {
            joint.state_interfaces.emplace_back();
            joint.state_interfaces.back().name = name;
        }
        info.joints.push_back(joint);
    }
    hardware_interface::ComponentInfo imu;
    imu.name = "trunk_imu";
    imu.parameters["motord_imu"] = "base";
    for (const char *name : {"orientation.x", "orientation.y", "orientation.z", "orientation.w", "angular_velocity.z",
                             "linear_acceleration.z"}) {
        imu.state_interfaces.emplace_back();
        imu.state_interfaces.back().name = name;
    }
    info.sensors.push_back(imu);
    return info;
}

/// Drives a plug-in as HardwareComponent of ros2_control does.
class Manager {
public:
    explicit Manager(const hardware_interface::HardwareInfo &info = description()) { initialised_ = system_.on_init({info, {}}); }

    CallbackReturn initialised() const { return initialised_; }
    CallbackReturn configure() { return moved(system_.on_configure(state()), Id::PRIMARY_STATE_INACTIVE); }
    CallbackReturn activate() { return moved(system_.on_activate(state()), Id::PRIMARY_STATE_ACTIVE); }
    CallbackReturn deactivate() { return moved(system_.on_deactivate(state()), Id::PRIMARY_STATE_INACTIVE); }
    std::uint8_t id() const { return id_; }

    /// A cycle of the controller manager: read, update, write. An ERROR is the error transition.
    return_type cycle(const std::function<void()> &update = [] {}) {
        const rclcpp::Time time(0);
        const rclcpp::Duration period(0, 1000000);
        auto result = system_.read(time, period);
        if (result == return_type::OK) {
            update();
            result = system_.write(time, period);
        }
        if (result != return_type::OK && id_ != Id::PRIMARY_STATE_UNCONFIGURED)
            error();
        std::this_thread::sleep_for(1ms);
        return result;
    }
    /// Cycles for a time; fails at the first that is not OK.
    void run(std::chrono::milliseconds time, const std::function<void(double)> &update = [](double) {}) {
        const auto begun = std::chrono::steady_clock::now();
        for (double at = 0.0; at < std::chrono::duration<double>(time).count();) {
            at = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
            CHECK(cycle([&] { update(at); }) == return_type::OK);
        }
    }
    /// Cycles until one fails. Its state then is that of the error transition.
    void until_error() {
        for (int left = 20000; cycle() == return_type::OK; --left)
            CHECK(left > 0);
    }

    void claim(const std::vector<std::string> &names) { CHECK(system_.perform_command_mode_switch(names, {}) == return_type::OK); }
    void let_go(const std::vector<std::string> &names) {
        CHECK(system_.perform_command_mode_switch({}, names) == return_type::OK);
    }
    double state(const std::string &name) const { return system_.get_state(name); }
    double command(const std::string &name) const { return system_.get_command(name); }
    void set(const std::string &name, double value) { system_.set_command(name, value); }

private:
    rclcpp_lifecycle::State state() const { return {id_, ""}; }
    CallbackReturn moved(CallbackReturn result, std::uint8_t next) {
        if (result == CallbackReturn::SUCCESS)
            id_ = next;
        else if (result == CallbackReturn::ERROR)
            error();
        return result;
    }
    void error() {
        id_ = system_.on_error(state()) == CallbackReturn::SUCCESS ? Id::PRIMARY_STATE_UNCONFIGURED : Id::PRIMARY_STATE_FINALIZED;
    }

    MotordSystem system_;
    CallbackReturn initialised_ = CallbackReturn::ERROR;
    std::uint8_t id_ = Id::PRIMARY_STATE_UNCONFIGURED;
};

/// Another client of the daemon, which sees what the motors get.
class Watcher {
public:
    motord_joint joint(const std::string &name) {
        client_.wait(state_);
        return state_.joint(client_.joint(name));
    }
    /// Waits until a joint fulfils a condition.
    motord_joint until(const std::string &name, const std::function<bool(const motord_joint &)> &condition) {
        for (int left = 20000;; --left) {
            const auto joint = this->joint(name);
            if (condition(joint))
                return joint;
            CHECK(left > 0);
        }
    }
    void until_limp() {
        for (const char *name : JOINTS)
            until(name, [](const motord_joint &joint) { return joint.mode != MOTORD_MODE_ACTIVE; });
    }
    void stop() { client_.emergency_stop(); }

private:
    motord::Client client_{"demo"};
    motord::State state_;
};

std::vector<std::string> interfaces(const std::string &interface) {
    std::vector<std::string> names;
    for (const char *joint : JOINTS)
        names.push_back(std::string(joint) + "/" + interface);
    return names;
}

void person_resets() { CHECK(std::system("motorctl --instance demo reset legs --wait >&2") == 0); }

/// What a joint does without stiffness or damping of its own, by the interfaces that controllers write.
void gains_follow_the_claimed_interfaces() {
    using namespace motord_hardware;
    const std::array<double, COMMANDS> written = {1.0, 2.0, 3.0, 4.0, 5.0};
    const auto gains = [&](Controlled controlled) {
        const auto next = setpoint(written, controlled, 0.5, 40.0, 1.0);
        return std::array<double, 5>{next.position, next.velocity, next.effort, next.kp, next.kd};
    };
    using Values = std::array<double, 5>;
    CHECK((gains({}) == Values{0.5, 0.0, 0.0, 40.0, 1.0}));
    CHECK((gains({true}) == Values{1.0, 0.0, 0.0, 40.0, 1.0}));
    CHECK((gains({false, true}) == Values{0.5, 2.0, 0.0, 0.0, 1.0}));
    CHECK((gains({false, false, true}) == Values{0.5, 0.0, 3.0, 0.0, 0.0}));
    CHECK((gains({false, true, true}) == Values{0.5, 2.0, 3.0, 0.0, 1.0}));
    CHECK((gains({false, false, false, true, true}) == Values{0.5, 0.0, 0.0, 4.0, 5.0}));
    CHECK((gains({true, true, true, true, true}) == Values{1.0, 2.0, 3.0, 4.0, 5.0}));
}

/// Inactive: states, no owner, no motion.
void configured_hardware_reads_without_owning() {
    Manager manager;
    CHECK(manager.initialised() == CallbackReturn::SUCCESS && manager.configure() == CallbackReturn::SUCCESS);
    manager.run(200ms);
    CHECK(std::abs(manager.state("fl-knee/position") + 1.6) < 0.3 && std::isnan(manager.command("fl-knee/position")));
    CHECK(std::isfinite(manager.state("fl-knee/velocity")) && std::isfinite(manager.state("fl-knee/effort")));
    CHECK(std::abs(manager.state("trunk_imu/orientation.w") - 1.0) < 0.1);
    CHECK(std::abs(manager.state("trunk_imu/linear_acceleration.z") - 9.81) < 1.0);
    motord::Client other("demo");
    motord::Claim claim(other, "legs");
}

void activation_holds_the_measured_positions() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS);
    manager.run(50ms);
    std::map<std::string, double> before;
    for (const auto &name : interfaces("position"))
        before[name] = manager.state(name);
    CHECK(manager.activate() == CallbackReturn::SUCCESS);
    for (const auto &[name, position] : before)
        CHECK(std::abs(manager.command(name) - position) < 0.01);
    CHECK(manager.command("fl-hip/velocity") == 0.0 && manager.command("fl-hip/effort") == 0.0);
    CHECK(manager.command("fl-hip/stiffness") == 40.0 && manager.command("fl-hip/damping") == 1.0);
    // No controller, then one that has written nothing: nothing moves.
    manager.run(300ms, [&](double) {
        for (const auto &[name, position] : before)
            CHECK(std::abs(manager.state(name) - position) < 0.05);
    });
    manager.claim(interfaces("position"));
    for (const auto &name : interfaces("position"))
        manager.set(name, std::nan(""));
    manager.run(300ms, [&](double) {
        for (const auto &[name, position] : before)
            CHECK(std::abs(manager.state(name) - position) < 0.05);
    });
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

void joints_follow_position_commands() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.claim(interfaces("position"));
    std::map<std::string, double> start;
    for (const auto &name : interfaces("position"))
        start[name] = manager.command(name);
    double worst = 0.0;
    manager.run(2000ms, [&](double at) {
        const double offset = 0.1 * std::sin(3.0 * at) * std::min(at, 1.0);
        for (const auto &[name, position] : start) {
            worst = std::max(worst, std::abs(manager.state(name) - manager.command(name)));
            manager.set(name, position + offset);
        }
    });
    std::printf("largest error %.4f rad\n", worst);
    CHECK(worst < 0.1);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

/// Each joint gets the command of its own name, in whatever order.
void commands_reach_the_joint_of_their_name() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    Watcher watcher;
    manager.claim({"fl-hip/stiffness", "fl-hip/damping", "rr-knee/effort", "rr-knee/damping"});
    manager.run(500ms, [&](double) {
        manager.set("fl-hip/stiffness", 12.0);
        manager.set("fl-hip/damping", 0.7);
        manager.set("rr-knee/effort", 0.4);
        manager.set("rr-knee/damping", 4.0);
    });
    const auto hip = watcher.joint("fl-hip"), knee = watcher.joint("rr-knee"), other = watcher.joint("fr-hip");
    CHECK(std::abs(hip.applied_kp - 12.0) < 0.2 && std::abs(hip.applied_kd - 0.7) < 0.05);
    // An effort without a position: no stiffness.
    CHECK(knee.applied_kp == 0.0 && std::abs(knee.applied_kd - 4.0) < 0.1 && std::abs(knee.applied_torque - 0.4) < 0.1);
    CHECK(std::abs(other.applied_kp - 40.0) < 0.5 && std::abs(other.applied_torque) < 0.1);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

void command_of_a_gone_controller_ends() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.claim({"fl-hip/effort", "fl-hip/damping"});
    manager.run(300ms, [&](double) {
        manager.set("fl-hip/effort", 0.4);
        manager.set("fl-hip/damping", 4.0);
    });
    const double left_at = manager.state("fl-hip/position");
    manager.let_go({"fl-hip/effort", "fl-hip/damping", "another_robot/effort"});
    CHECK(manager.command("fl-hip/effort") == 0.0 && manager.command("fl-hip/damping") == 1.0);
    manager.run(500ms);
    // Stiffness returns at the position where the controller left, not where it began.
    Watcher watcher;
    const auto hip = watcher.joint("fl-hip");
    CHECK(std::abs(hip.applied_torque) < 0.05 && hip.applied_kp > 39.0);
    CHECK(std::abs(hip.applied_position - left_at) < 0.05);
    // A controller of positions leaves its last one: no step of the torque.
    manager.claim({"fl-hip/position"});
    const double goal = manager.state("fl-hip/position") + 0.02;
    manager.run(300ms, [&](double) { manager.set("fl-hip/position", goal); });
    manager.let_go({"fl-hip/position"});
    manager.run(100ms);
    CHECK(std::abs(watcher.joint("fl-hip").applied_position - goal) < 0.005);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

void infinite_commands_hold_the_joint() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.claim(interfaces("position"));
    const double held = manager.command("fl-hip/position");
    manager.run(300ms, [&](double) { manager.set("fl-hip/position", INFINITY); });
    CHECK(std::abs(manager.state("fl-hip/position") - held) < 0.05);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

void deactivation_damps_and_releases() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.run(100ms);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS && manager.id() == Id::PRIMARY_STATE_INACTIVE);
    Watcher().until_limp();
    // States go on, another client may own the group, and no cause is latched.
    manager.run(100ms);
    { motord::Client other("demo"); motord::Claim claim(other, "legs"); }
    CHECK(manager.activate() == CallbackReturn::SUCCESS);
    manager.run(100ms);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

void stop_is_an_error_until_a_reset() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.run(100ms);
    Watcher watcher;
    std::thread person([&] { watcher.stop(); });
    manager.until_error();
    person.join();
    CHECK(manager.id() == Id::PRIMARY_STATE_UNCONFIGURED);
    watcher.until_limp();
    // The plug-in resets nothing by itself.
    CHECK(manager.configure() == CallbackReturn::SUCCESS);
    CHECK(manager.activate() == CallbackReturn::FAILURE && manager.id() == Id::PRIMARY_STATE_INACTIVE);
    person_resets();
    CHECK(manager.activate() == CallbackReturn::SUCCESS);
    manager.run(200ms);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

/// A controller manager that hangs: the daemon's timeout.
void hanging_manager_is_damped() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.run(100ms);
    Watcher().until_limp();
    manager.until_error();
    CHECK(manager.id() == Id::PRIMARY_STATE_UNCONFIGURED);
    person_resets();
}

/// A controller manager that ends without a transition, as after Ctrl-C.
void end_of_the_manager_damps() {
    {
        Manager manager;
        CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
        manager.run(100ms);
    }
    Watcher().until_limp();
    motord::Client other("demo");
    motord::Claim claim(other, "legs");
}

void wrong_description_is_refused() {
    const auto refused = [](const std::function<void(hardware_interface::HardwareInfo &)> &change) {
        auto info = description();
        change(info);
        Manager manager(info);
        return manager.initialised() == CallbackReturn::ERROR;
    };
    for (const char *bad : {"", "x", "nan", "inf", "-1", "1.0 N"})
        CHECK(refused([bad](auto &info) { info.hardware_parameters["kp"] = bad; }));
    CHECK(refused([](auto &info) { info.joints[0].command_interfaces[0].name = "acceleration"; }));
    CHECK(refused([](auto &info) { info.sensors[0].state_interfaces[0].name = "pressure"; }));
    const auto unconfigured = [](const std::function<void(hardware_interface::HardwareInfo &)> &change) {
        auto info = description();
        change(info);
        Manager manager(info);
        return manager.initialised() == CallbackReturn::SUCCESS && manager.configure() == CallbackReturn::FAILURE;
    };
    CHECK(unconfigured([](auto &info) { info.joints[0].name = "tail"; }));
    CHECK(unconfigured([](auto &info) { info.hardware_parameters["instance"] = "absent"; }));
    CHECK(unconfigured([](auto &info) { info.hardware_parameters["kp"] = "1e6"; }));
    CHECK(unconfigured([](auto &info) { info.sensors[0].parameters["motord_imu"] = "absent"; }));
    // A joint of the group that the URDF lacks would have no setpoint.
    auto info = description();
    info.joints.pop_back();
    Manager manager(info);
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::FAILURE);
    motord::Client other("demo");
    motord::Claim claim(other, "legs");
}

void motord_names_may_differ() {
    auto info = description();
    for (auto &joint : info.joints) {
        joint.parameters["motord_joint"] = joint.name;
        joint.name = "leg_" + joint.name;
    }
    Manager manager(info);
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    manager.run(100ms);
    CHECK(std::abs(manager.state("leg_fl-knee/position") + 1.6) < 0.5);
    CHECK(manager.deactivate() == CallbackReturn::SUCCESS);
}

/// Runs until it is killed: prints a line once the motors follow.
void active_until_killed() {
    Manager manager;
    CHECK(manager.configure() == CallbackReturn::SUCCESS && manager.activate() == CallbackReturn::SUCCESS);
    std::puts("active");
    std::fflush(stdout);
    manager.run(3600s);
}

const std::map<std::string, void (*)()> SCENARIOS = {
#define SCENARIO(name) {#name, name}
    SCENARIO(gains_follow_the_claimed_interfaces),
    SCENARIO(configured_hardware_reads_without_owning),
    SCENARIO(activation_holds_the_measured_positions),
    SCENARIO(joints_follow_position_commands),
    SCENARIO(commands_reach_the_joint_of_their_name),
    SCENARIO(command_of_a_gone_controller_ends),
    SCENARIO(infinite_commands_hold_the_joint),
    SCENARIO(deactivation_damps_and_releases),
    SCENARIO(stop_is_an_error_until_a_reset),
    SCENARIO(hanging_manager_is_damped),
    SCENARIO(end_of_the_manager_damps),
    SCENARIO(wrong_description_is_refused),
    SCENARIO(motord_names_may_differ),
    SCENARIO(active_until_killed),
#undef SCENARIO
};

} // namespace

int main(int argc, char **argv) {
    const auto found = argc == 2 ? SCENARIOS.find(argv[1]) : SCENARIOS.end();
    if (found == SCENARIOS.end()) {
        for (const auto &[name, run] : SCENARIOS)
            std::puts(name.c_str());
        return argc == 1 ? EXIT_SUCCESS : EXIT_FAILURE;
    }
    try {
        found->second();
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
        return EXIT_FAILURE;
    }
    return EXIT_SUCCESS;
}

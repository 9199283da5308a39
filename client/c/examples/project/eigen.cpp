// Eigen vectors over the arrays of a claim, in the order of another list of names, such as that of a URDF or of Pinocchio. Moves the
// joints of the simulated quadruped along a sine by a torque that is computed by Eigen: kp (goal - q) + kd (goal' - dq).
//
//   eigen [INSTANCE [GROUP [SECONDS]]]

#include <motord.hpp>

#include <Eigen/Core>

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace {

class Holding {
public:
    Holding(const std::string &instance, const std::string &group) : client_(instance), claim_(client_, group) {
        const std::size_t count = claim_.size();
        for (auto *values : {&position_, &velocity_, &torque_})
            values->resize(count);
        // The names of the model: here those of the robot, backwards. Pinocchio's begin with "universe", and with the joint of a
        // floating base: leave these out.
        const std::vector<std::string> robot = client_.names(MOTORD_LIST_JOINTS);
        std::vector<std::string> names;
        for (std::size_t joint : claim_.joints())
            names.insert(names.begin(), robot[joint]);
        const std::vector<std::size_t> order = claim_.indices(client_, names);
        order_ = Eigen::Map<const Eigen::Array<std::size_t, Eigen::Dynamic, 1>>(order.data(), size()).cast<Eigen::Index>();
    }

    // Moves the group around where it is until `seconds` are over. Returns the root mean square of the error, rad.
    double run(double seconds) {
        start();
        const Eigen::ArrayXd begin = in_order(position_);
        const auto first = state_.cycle().tick_ns;
        double square = 0.0, cycles = 0.0;
        for (double time = 0.0; time < seconds; cycles += 1.0) {
            client_.wait(state_);
            claim_.must_be_active(state_);
            read();
            time = static_cast<double>(state_.cycle().tick_ns - first) * 1e-9;
            const Eigen::ArrayXd error = begin + amplitude * std::sin(omega * time) - in_order(position_).array();
            const Eigen::ArrayXd slip = amplitude * omega * std::cos(omega * time) - in_order(velocity_).array();
            square += error.square().mean();
            // In the order of the names; the array of the claim gets it in its own.
            Eigen::Map<Eigen::VectorXd> torque(torque_.data(), size());
            torque(order_) = kp * error + kd * slip;
            claim_.send({nullptr, nullptr, nullptr, nullptr, torque_.data()}, torque_.size());
        }
        return std::sqrt(square / cycles);
    }

private:
    static constexpr double kp = 20.0, kd = 0.5, amplitude = 0.1, omega = 3.0;

    Eigen::Index size() const { return static_cast<Eigen::Index>(claim_.size()); }

    // The values of an array of the claim, in the order of the names.
    Eigen::VectorXd in_order(const std::vector<double> &values) const {
        return Eigen::Map<const Eigen::VectorXd>(values.data(), size())(order_);
    }

    void read() {
        state_.read(claim_, MOTORD_QUANTITY_POSITION, position_);
        state_.read(claim_, MOTORD_QUANTITY_VELOCITY, velocity_);
    }

    void start() {
        claim_.wait_for(MOTORD_PHASE_DISARMED);
        client_.wait(state_);
        claim_.hold(state_, kp, kd);
        claim_.commit();
        claim_.enable();
        claim_.wait_for(MOTORD_PHASE_ACTIVE);
        client_.wait(state_);
        read();
    }

    motord::Client client_;
    motord::Claim claim_;
    motord::State state_;
    std::vector<double> position_, velocity_, torque_;
    Eigen::Array<Eigen::Index, Eigen::Dynamic, 1> order_;
};

} // namespace

int main(int argc, char **argv) {
    const char *const chosen = argc > 1 ? argv[1] : std::getenv("MOTORD_INSTANCE");
    const std::string instance = chosen != nullptr ? chosen : "demo";
    const std::string group = argc > 2 ? argv[2] : "legs";
    const double seconds = argc > 3 ? std::atof(argv[3]) : 10.0;
    try {
        Holding holding(instance, group);
        std::printf("error %.4f rad RMS\n", holding.run(seconds));
        return EXIT_SUCCESS;
    } catch (const motord::Error &error) {
        std::fprintf(stderr, "eigen: %s\n", error.what());
        return EXIT_FAILURE;
    }
}

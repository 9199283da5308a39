// Lets the legs of the simulated quadruped swing at 500 Hz: a class to copy. It claims again after a restart of the daemon.
//
//   trot [INSTANCE [GROUP [SECONDS]]]

#include <motord.hpp>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>

namespace {

using namespace std::chrono_literals;

class Trot {
public:
    Trot(const std::string &instance, const std::string &group) : client_(instance), claim_(client_, group) {
        const auto count = claim_.size();
        for (auto *values : {&start_, &position_, &velocity_, &measured_})
            values->resize(count);
        kp_.assign(count, 40.0);
        kd_.assign(count, 1.0);
    }

    // Starts the group where it is, then swings until `seconds` are over. Returns the root mean square of the error, rad.
    double run(double seconds) {
        start();
        const auto first = state_.cycle().tick_ns;
        double square = 0.0;
        std::size_t values = 0;
        for (double time = 0.0; time < seconds;) {
            client_.wait_cycles(state_, 2);
            claim_.must_be_active(state_);
            state_.read(claim_, MOTORD_QUANTITY_POSITION, measured_);
            for (std::size_t joint = 0; joint < measured_.size(); ++joint, ++values)
                square += std::pow(measured_[joint] - position_[joint], 2);
            time = static_cast<double>(state_.cycle().tick_ns - first) * 1e-9;
            swing(time);
            claim_.send({position_.data(), velocity_.data(), kp_.data(), kd_.data(), nullptr}, position_.size());
        }
        return std::sqrt(square / static_cast<double>(values));
    }

private:
    void start() {
        // Another controller may have left a moment ago.
        claim_.wait_for(MOTORD_PHASE_DISARMED);
        client_.wait(state_);
        claim_.hold(state_, kp_.front(), kd_.front());
        claim_.commit();
        state_.read(claim_, MOTORD_QUANTITY_POSITION, start_);
        position_ = start_;
        claim_.enable();
        claim_.wait_for(MOTORD_PHASE_ACTIVE);
        client_.wait(state_);
    }

    // 0.1 rad, once in a second; the amplitude rises within the first second.
    void swing(double time) {
        const double turn = 2.0 * 3.14159265358979323846;
        const double size = 0.1 * std::fmin(time, 1.0);
        for (std::size_t joint = 0; joint < position_.size(); ++joint) {
            const double sign = joint % 2 == 0 ? 1.0 : -1.0;
            position_[joint] = start_[joint] + sign * size * std::sin(turn * time);
            velocity_[joint] = sign * size * turn * std::cos(turn * time);
        }
    }

    motord::Client client_;
    motord::Claim claim_;
    motord::State state_;
    std::vector<double> start_, position_, velocity_, kp_, kd_, measured_;
};

} // namespace

int main(int argc, char **argv) {
    const char *const chosen = argc > 1 ? argv[1] : std::getenv("MOTORD_INSTANCE");
    const std::string instance = chosen != nullptr ? chosen : "demo";
    const std::string group = argc > 2 ? argv[2] : "legs";
    const double seconds = argc > 3 ? std::atof(argv[3]) : 10.0;
    for (;;) {
        try {
            Trot trot(instance, group);
            std::printf("error %.4f rad RMS\n", trot.run(seconds));
            return EXIT_SUCCESS;
        } catch (const motord::Restarted &) {
            std::puts("motord was restarted: claiming again");
        } catch (const motord::NotRunning &) {
            std::this_thread::sleep_for(200ms);
        } catch (const motord::Error &error) {
            std::fprintf(stderr, "trot: %s\n", error.what());
            return EXIT_FAILURE;
        }
    }
}

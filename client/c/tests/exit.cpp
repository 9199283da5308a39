// Calls the library after main: from an exit handler, and from the destructor of a static object, which disables its group.
//
//   exit [INSTANCE [GROUP]]
//
// A failure there must return its status, and a call must still reach the daemon: thread-local objects no longer exist then.

#include <motord.hpp>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>

namespace {

void require(bool holds, const char *what) {
    if (holds)
        return;
    std::fprintf(stderr, "exit: %s\n", what);
    std::_Exit(EXIT_FAILURE);
}

class Robot {
public:
    void start(const std::string &instance, const std::string &group) {
        client_ = std::make_unique<motord::Client>(instance);
        claim_ = std::make_unique<motord::Claim>(*client_, group);
        motord::State state;
        client_->wait(state);
        claim_->hold(state, 20.0, 0.5);
        claim_->commit();
        claim_->enable();
        claim_->wait_for(MOTORD_PHASE_ACTIVE);
    }

    void send_nonsense() {
        const std::vector<double> nonsense(claim_->size(), std::nan("")), stiffness(claim_->size(), 20.0);
        try {
            claim_->send({nonsense.data(), nullptr, stiffness.data(), nullptr, nullptr}, nonsense.size());
        } catch (const motord::Error &error) {
            require(error.status() == MOTORD_STATUS_BAD_SETPOINT, error.what());
            return;
        }
        require(false, "a setpoint that is not finite was sent");
    }

    ~Robot() {
        try {
            claim_->disable();
            claim_->wait_for(MOTORD_PHASE_DISARMED);
        } catch (const motord::Error &error) {
            require(false, error.what());
        }
        std::puts("disabled after main");
    }

private:
    std::unique_ptr<motord::Client> client_;
    std::unique_ptr<motord::Claim> claim_;
};

Robot robot;

void at_exit() { robot.send_nonsense(); }

} // namespace

int main(int argc, char **argv) {
    try {
        robot.start(argc > 1 ? argv[1] : "demo", argc > 2 ? argv[2] : "legs");
    } catch (const motord::Error &error) {
        require(false, error.what());
    }
    robot.send_nonsense();
    require(std::string(motord_error_message()).find("finite number") != std::string::npos, motord_error_message());
    require(std::atexit(at_exit) == 0, "no exit handler");
    return EXIT_SUCCESS;
}

// Publishes a resting body as x, y, z, w until motord names it, and a sample of another clock.
//
//   imu INSTANCE IMU

#include <motord.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace {

constexpr std::uint32_t quaternion_xyzw = 1;

/// Roll 0.4, pitch 0.3, yaw 0.5 rad, with noise.
motord_imu_sample measured(int turn) {
    motord_imu_sample sample{};
    const double orientation[4] = {0.154097, 0.190506, 0.210984, 0.946281};
    std::copy(orientation, orientation + 4, sample.orientation);
    sample.acceleration[0] = -2.899;
    sample.acceleration[1] = 3.650;
    sample.acceleration[2] = 8.632 + 1e-3 * (turn % 7);
    sample.temperature = NAN;
    return sample;
}

} // namespace

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    try {
        const motord::Client client(argv[1]);
        const std::size_t index = client.imu(argv[2]);
        motord::State state;
        motord::ImuPublisher publisher(client, argv[2]);
        std::uint32_t found = 0;
        for (int turn = 0; turn < 5000 && found == 0; ++turn) {
            publisher.send(measured(turn));
            client.wait(state);
            found = state.imu(index).contradictions;
        }
        motord_imu_sample dated = measured(0);
        const auto realtime = std::chrono::system_clock::now().time_since_epoch();
        dated.time_ns = static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(realtime).count());
        const motord_status status = publisher.try_send(dated);
        std::printf("contradictions %u; %s\n", found, motord_error_message());
        return found == quaternion_xyzw && status == MOTORD_STATUS_BAD_SETPOINT ? EXIT_SUCCESS : EXIT_FAILURE;
    } catch (const motord::Error &error) {
        std::fprintf(stderr, "imu: %s\n", error.what());
        return EXIT_FAILURE;
    }
}

// Arrays with a size, for C++20: they are read and sent as those of C++17, and an array of another size is refused.
//
//   spans INSTANCE GROUP

#include <motord.hpp>

#include <array>
#include <cstdio>
#include <cstdlib>

#if !defined(__cpp_lib_span)
#error "compile with -std=c++20: motord.hpp has no spans in an earlier standard"
#endif

namespace {

int failures = 0;

void require(bool holds, const std::string &what) {
    if (holds)
        return;
    std::fprintf(stderr, "spans: %s\n", what.c_str());
    ++failures;
}

/// Both calls of C++17 and C++20 read the same numbers, in both precisions.
void check_reads(const motord::Claim &claim, const motord::State &state) {
    std::vector<double> expected, wide(claim.size());
    std::vector<float> narrow(claim.size());
    state.read(claim, MOTORD_QUANTITY_POSITION, expected);
    state.read(claim, MOTORD_QUANTITY_POSITION, std::span(wide));
    state.read(claim, MOTORD_QUANTITY_POSITION, std::span(narrow));
    require(wide == expected, "a span has other positions than a vector");
    for (std::size_t joint = 0; joint < wide.size(); ++joint)
        require(narrow[joint] == static_cast<float>(wide[joint]), "a position differs in single precision");
    std::vector<double> longer(claim.size() + 1);
    require(state.try_read(claim, MOTORD_QUANTITY_POSITION, longer) == MOTORD_STATUS_BAD_ARGUMENT, "a longer span is read");
    require(state.try_read(claim, MOTORD_QUANTITY_POSITION, std::span<float>()) == MOTORD_STATUS_BAD_ARGUMENT,
            "an empty span is read");
}

/// Sends for some cycles, and returns the applied stiffness of the first joint.
template <typename Setpoints>
double follow(motord::Client &client, motord::Claim &claim, motord::State &state, const Setpoints &setpoints) {
    std::vector<double> kp;
    for (int cycle = 0; cycle < 200; ++cycle) {
        claim.send(setpoints);
        client.wait(state);
    }
    state.read(claim, MOTORD_QUANTITY_APPLIED_KP, kp);
    return kp.front();
}

void check_sends(motord::Client &client, motord::Claim &claim, motord::State &state) {
    const std::size_t count = claim.size();
    std::vector<double> position(count), kp(count, 12.0), kd(count, 0.5);
    state.read(claim, MOTORD_QUANTITY_POSITION, std::span(position));
    require(follow(client, claim, state, motord::SetpointSpans{.position = position, .kp = kp, .kd = kd}) == 12.0, "a span is not sent");
    std::vector<float> narrow(position.begin(), position.end());
    const std::vector<float> stiff(count, 14.0F), damping(count, 0.5F);
    require(follow(client, claim, state, motord::SetpointSpansF32{narrow, {}, stiff, damping, {}}) == 14.0,
            "a span of single precision is not sent");
    // Every array is checked, and not only the first.
    kd.pop_back();
    require(claim.try_send(motord::SetpointSpans{position, {}, kp, kd, {}}) == MOTORD_STATUS_BAD_ARGUMENT, "a shorter array is sent");
    try {
        claim.send(motord::SetpointSpans{position, {}, kp, kd, {}});
    } catch (const motord::Error &error) {
        const std::string sentence = error.what();
        require(sentence.find(std::to_string(count - 1)) != std::string::npos, "the sentence has no size: " + sentence);
    }
    require(claim.try_send(motord::SetpointSpans{}) == MOTORD_STATUS_OK, "no array is an error, instead of zero torque");
}

} // namespace

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    try {
        motord::Client client(argv[1]);
        motord::Claim claim(client, argv[2]);
        motord::State state;
        client.wait(state);
        check_reads(claim, state);
        claim.hold(state, 10.0, 0.5);
        claim.commit();
        claim.enable();
        claim.wait_for(MOTORD_PHASE_ACTIVE);
        client.wait(state);
        check_sends(client, claim, state);
        claim.disable();
        claim.wait_for(MOTORD_PHASE_DISARMED);
    } catch (const motord::Error &error) {
        require(false, error.what());
    }
    return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

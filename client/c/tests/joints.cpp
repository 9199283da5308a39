// Reads each joint while a group follows setpoints that a limit clamps, or one whose motor does not answer. Waits for every fifth cycle,
// orders the claim by name, and uses a freed claim.
//
//   joints INSTANCE GROUP          every motor answers
//   joints INSTANCE offline JOINT  this motor does not

#include <motord.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

namespace {

int failures = 0;

void require(bool holds, const std::string &what) {
    if (holds)
        return;
    std::fprintf(stderr, "joints: %s\n", what.c_str());
    ++failures;
}

bool contains(const std::vector<std::string> &names, const char *name) {
    return std::find(names.begin(), names.end(), name) != names.end();
}

/// Holds the group without stiffness, at positions above those permitted, for some cycles.
void follow_clamped(motord::Client &client, motord::Claim &claim, motord::State &state) {
    std::vector<double> position, none(claim.size(), 0.0), kd(claim.size(), 0.5);
    for (std::size_t joint : claim.joints())
        position.push_back(client.limits(joint).position_max + 0.5);
    for (int cycle = 0; cycle < 50; ++cycle) {
        claim.send({position.data(), nullptr, none.data(), kd.data(), nullptr}, position.size());
        client.wait(state);
    }
}

void check_joints(const motord::Client &client, const motord::Claim &claim, const motord::State &state) {
    std::vector<double> ages, kds;
    state.read(claim, MOTORD_QUANTITY_AGE, ages);
    state.read(claim, MOTORD_QUANTITY_APPLIED_KD, kds);
    const std::vector<std::string> names = client.names(MOTORD_LIST_JOINTS);
    for (std::size_t place = 0; place < ages.size(); ++place) {
        const std::size_t index = claim.joints()[place];
        const motord_joint joint = state.joint(index);
        const std::string &name = names[index];
        require(joint.mode == MOTORD_MODE_ACTIVE && motord::name(joint.mode) == "active", name + " is not active");
        require(joint.faults == 0 && motord::faults(joint).empty(), name + " has faults");
        require((joint.limits & MOTORD_LIMIT_POSITION) != 0, name + " has no clamped position");
        require(contains(motord::limits(joint), "position"), name + " names no limit");
        require(joint.applied_position <= client.limits(index).position_max, name + " got a position beyond its limit");
        require(joint.applied_kd == kds[place] && joint.applied_kp == 0.0, name + " got other gains");
        require(joint.age >= ages[place] && joint.age < 1.0 && ages[place] > 0.0, name + " has another age");
        require(!joint.fresh || joint.age_cycles == 0, name + " is fresh and old");
        require(!joint.mismatch && std::isfinite(joint.position), name + " has no position");
    }
    motord_joint none{};
    require(state.try_joint(names.size(), none) == MOTORD_STATUS_UNKNOWN, "a joint that does not exist is read");
}

/// Cycles whose number is a multiple of five, or a later one where this thread was late.
void wait_for_every_fifth(const motord::Client &client, motord::State &state) {
    client.wait_cycles(state, 5);
    for (int turn = 0; turn < 100; ++turn) {
        const std::uint64_t due = (state.cycle().cycle / 5 + 1) * 5;
        client.wait_cycles(state, 5);
        require(state.cycle().cycle >= due, "a state before cycle " + std::to_string(due));
    }
}

/// The order of a controller is kept, and one that does not fit is refused.
void check_order(const motord::Client &client, const motord::Claim &claim) {
    const std::vector<std::string> all = client.names(MOTORD_LIST_JOINTS);
    const std::vector<std::size_t> joints = claim.joints();
    std::vector<std::string> names;
    for (std::size_t joint : joints)
        names.push_back(all[joint]);
    std::rotate(names.begin(), names.begin() + 5, names.end());
    const std::vector<std::size_t> indices = claim.indices(client, names);
    require(indices.size() == joints.size(), "the order has another length");
    for (std::size_t at = 0; at < indices.size(); ++at)
        require(all[joints[indices[at]]] == names[at] && indices[at] == (at + 5) % joints.size(), names[at] + " has another index");

    std::string claimed = "the claim has " + all[joints[0]];
    for (std::size_t at = 1; at < joints.size(); ++at)
        claimed += ", " + all[joints[at]];
    const auto refused = [&](std::vector<std::string> given, motord_status status, const std::string &sentence) {
        try {
            claim.indices(client, given);
            require(false, "these names are taken, without: " + sentence);
        } catch (const motord::Error &error) {
            require(error.status() == status && error.what() == sentence + "; " + claimed, error.what());
        }
    };
    std::vector<std::string> given = names;
    given[3] = "tail";
    refused(given, MOTORD_STATUS_UNKNOWN, "there is no joint \"tail\"");
    given[3] = names[4];
    refused(given, MOTORD_STATUS_BAD_ARGUMENT, "names has " + names[4] + " twice");
    given.assign(names.begin(), names.end() - 1);
    refused(given, MOTORD_STATUS_BAD_ARGUMENT, "names lacks " + names.back() + ": name each joint of the claim");
}

void use_freed_claim(const motord::Client &client, const std::string &group) {
    motord_claim *claim = nullptr;
    require(motord_claim_group(client.get(), group.c_str(), &claim) == MOTORD_STATUS_OK, motord_error_message());
    motord_claim_free(claim);
    const motord::Claim other(client, group);
    require(motord_commit(claim) == MOTORD_STATUS_BAD_ARGUMENT, "a freed claim is used");
    require(std::string(motord_error_message()) == "this motord_claim was freed, or is no motord_claim", motord_error_message());
    motord_claim_free(claim);
    require(other.size() > 0 && motord_claim_count(claim) == 0, "a freed claim is another one");
}

void check_offline(const motord::Client &client, const motord::State &state, const std::string &name) {
    const motord_joint joint = state.joint(client.joint(name));
    require(joint.mode == MOTORD_MODE_OFFLINE, name + " is " + std::string(motord::name(joint.mode)));
    require(!joint.fresh && joint.missed > 0 && joint.age_cycles > 0 && joint.age > 0.0, name + " is fresh");
}

} // namespace

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    try {
        motord::Client client(argv[1]);
        motord::State state;
        client.wait(state);
        if (argc > 3) {
            check_offline(client, state, argv[3]);
            return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
        }
        {
            motord::Claim claim(client, argv[2]);
            check_order(client, claim);
            claim.hold(state, 20.0, 0.5);
            claim.commit();
            claim.enable();
            claim.wait_for(MOTORD_PHASE_ACTIVE);
            follow_clamped(client, claim, state);
            check_joints(client, claim, state);
            claim.disable();
            claim.wait_for(MOTORD_PHASE_DISARMED);
        }
        wait_for_every_fifth(client, state);
        use_freed_claim(client, argv[2]);
    } catch (const motord::Error &error) {
        require(false, error.what());
    }
    return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

// Forks while a group is active: the child is refused, ends every object, and changes nothing for the parent.
//
//   fork [INSTANCE [GROUP]]

#include <motord.hpp>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <sys/wait.h>
#include <unistd.h>

namespace {

int failures = 0;

void require(bool holds, const char *what) {
    if (holds)
        return;
    std::fprintf(stderr, "fork: %s\n", what);
    ++failures;
}

template <typename Call> void is_refused(const char *what, Call call) {
    try {
        call();
    } catch (const motord::Forked &error) {
        require(error.status() == MOTORD_STATUS_FORKED, error.what());
        return;
    } catch (const motord::Error &error) {
        std::fprintf(stderr, "fork: %s: %s\n", what, error.what());
    }
    require(false, what);
}

void hold(motord::Client &client, motord::Claim &claim, motord::State &state) {
    client.wait(state);
    claim.hold(state, 20.0, 0.5);
    claim.commit();
    claim.enable();
    claim.wait_for(MOTORD_PHASE_ACTIVE);
}

/// What a child does with the objects of its parent.
int child(std::unique_ptr<motord::Client> client, std::unique_ptr<motord::Claim> claim, motord::State &state) {
    is_refused("wait", [&] { client->wait(state); });
    is_refused("newest", [&] { client->newest(state); });
    is_refused("claim", [&] { motord::Claim other(*client, "legs"); });
    is_refused("commit", [&] { claim->commit(); });
    is_refused("enable", [&] { claim->enable(); });
    is_refused("disable", [&] { claim->disable(); });
    is_refused("release", [&] { claim->release(); });
    is_refused("must_be_active", [&] { claim->must_be_active(state); });
    require(claim->size() == 0 && client->names(MOTORD_LIST_JOINTS).empty(), "a value of the parent");
    claim.reset();
    client.reset();
    return failures;
}

} // namespace

int main(int argc, char **argv) {
    const char *instance = argc > 1 ? argv[1] : "demo";
    try {
        auto client = std::make_unique<motord::Client>(instance);
        auto claim = std::make_unique<motord::Claim>(*client, argc > 2 ? argv[2] : "legs");
        motord::State state;
        hold(*client, *claim, state);
        const pid_t pid = fork();
        if (pid == 0) std::exit(child(std::move(client), std::move(claim), state));
        int status = -1;
        for (int turn = 0; turn < 500; ++turn) {
            client->wait(state);
            claim->must_be_active(state);
            claim->commit();
        }
        require(waitpid(pid, &status, 0) == pid && status == 0, "the child failed");
        client->wait(state);
        claim->must_be_active(state);
    } catch (const motord::Error &error) {
        require(false, error.what());
    }
    if (failures == 0) std::puts("the child changed nothing");
    return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

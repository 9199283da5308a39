/* Holds every joint of a group where it is, until the group is stopped or the time is over.
 *
 *   hold [INSTANCE [GROUP [SECONDS]]]
 *
 * The default instance is MOTORD_INSTANCE, or demo.
 */
#include <motord.h>
#include <stdio.h>
#include <stdlib.h>

static const uint64_t SECOND = 1000000000;

static int failed(const char *what) {
    fprintf(stderr, "hold: %s: %s\n", what, motord_error_message());
    return EXIT_FAILURE;
}

static int hold(motord_client *client, motord_claim *claim, motord_state *state, double seconds) {
    if (motord_wait(client, SECOND, state) != MOTORD_STATUS_OK) return failed("wait");
    if (motord_hold(claim, state, 20.0, 0.5) != MOTORD_STATUS_OK) return failed("hold");
    if (motord_commit(claim) != MOTORD_STATUS_OK) return failed("send");
    if (motord_enable(claim) != MOTORD_STATUS_OK) return failed("enable");
    if (motord_wait_for(claim, MOTORD_PHASE_ACTIVE, 5 * SECOND) != MOTORD_STATUS_OK) return failed("start");
    printf("holding %zu joints\n", motord_claim_count(claim));
    fflush(stdout);
    motord_cycle first = {0}, now = {0};
    do {
        if (motord_wait(client, SECOND, state) != MOTORD_STATUS_OK) return failed("wait");
        if (motord_must_be_active(state, claim) != MOTORD_STATUS_OK) return failed("stopped");
        if (motord_commit(claim) != MOTORD_STATUS_OK) return failed("send");
        motord_state_cycle(state, &now);
        if (first.cycle == 0) first = now;
    } while ((double)(now.tick_ns - first.tick_ns) < seconds * 1e9);
    return EXIT_SUCCESS;
}

int main(int argc, char **argv) {
    const char *instance = argc > 1 ? argv[1] : getenv("MOTORD_INSTANCE");
    if (instance == NULL) instance = "demo";
    const char *group = argc > 2 ? argv[2] : "legs";
    double seconds = argc > 3 ? atof(argv[3]) : 10.0;
    int status = EXIT_FAILURE;
    motord_client *client = NULL;
    motord_claim *claim = NULL;
    motord_state *state = motord_state_new();
    if (motord_connect(instance, &client) != MOTORD_STATUS_OK) {
        failed("connect");
    } else if (motord_claim_group(client, group, &claim) != MOTORD_STATUS_OK) {
        failed("claim");
    } else {
        status = hold(client, claim, state, seconds);
    }
    /* Damps and stops the motors. */
    motord_claim_free(claim);
    motord_state_free(state);
    motord_client_free(client);
    return status;
}

/* dds TRIPS: a request and its reply over Cyclone DDS, reliable, keep last 1, between two processes. */
#include "payload.h"
#include "trips.h"
#include <dds/dds.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

struct end {
    dds_entity_t writer, reader, waitset;
};

static struct end end;
static Setpoint setpoint;
static State state;

static void open_end(const dds_topic_descriptor_t *sent, const char *sent_name, const dds_topic_descriptor_t *read,
                     const char *read_name)
{
    dds_entity_t participant = dds_create_participant(DDS_DOMAIN_DEFAULT, NULL, NULL);
    require(participant > 0, "dds_create_participant");
    dds_qos_t *qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
    end.writer = dds_create_writer(participant, dds_create_topic(participant, sent, sent_name, qos, NULL), qos, NULL);
    end.reader = dds_create_reader(participant, dds_create_topic(participant, read, read_name, qos, NULL), qos, NULL);
    end.waitset = dds_create_waitset(participant);
    require(end.writer > 0 && end.reader > 0, "dds_create_writer");
    require(dds_waitset_attach(end.waitset, dds_create_readcondition(end.reader, DDS_ANY_STATE), 0) == 0, "dds_waitset_attach");
    dds_publication_matched_status_t matched = { 0 };
    dds_subscription_matched_status_t heard = { 0 };
    while (matched.current_count == 0 || heard.current_count == 0) {
        dds_sleepfor(DDS_MSECS(10));
        dds_get_publication_matched_status(end.writer, &matched);
        dds_get_subscription_matched_status(end.reader, &heard);
    }
    dds_delete_qos(qos);
}

static void take(void *sample)
{
    dds_sample_info_t info;
    do
        dds_waitset_wait(end.waitset, NULL, 0, DDS_SECS(1));
    while (dds_take(end.reader, &sample, &info, 1, 1) != 1 || !info.valid_data);
}

static void trip(void)
{
    require(dds_write(end.writer, &setpoint) == 0, "dds_write");
    take(&state);
}

int main(int count, char **arguments)
{
    require(count == 2, "usage: dds TRIPS");
    pid_t echo = fork();
    require(echo >= 0, "fork");
    if (echo == 0) {
        open_end(&State_desc, "state", &Setpoint_desc, "setpoint");
        for (;;) {
            take(&setpoint);
            require(dds_write(end.writer, &state) == 0, "dds_write");
        }
    }
    open_end(&Setpoint_desc, "setpoint", &State_desc, "state");
    dds_sleepfor(DDS_MSECS(200));
    time_trips("cyclone-dds", strtoul(arguments[1], NULL, 10), trip);
    kill(echo, SIGKILL);
    waitpid(echo, NULL, 0);
}

/* codec FRAMES: a careful packing of MIT frames in C, as motord's: in double precision, clamped, rounded to the nearest code, NaN and
 * infinity refused, and never the bytes of a special frame or all zeros. The scales are those of a motor, computed once, as motord's: motors
 * of other vendors have other ranges.
 *
 * Prints the time of one frame each way, ns, and a checksum of all bytes and values, which must be that of motord.
 */
#include "trips.h"
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { DISTINCT = 256, RUNS = 10 };

struct impedance {
    float position, velocity, kp, kd, torque;
};

/* What motord tells of a state, too: temperatures and a status, which this vendor's replies do not have. */
struct state {
    uint8_t id, has_status, status;
    float position, velocity, torque;
    uint16_t codes[3];
    struct {
        int is_known;
        float celsius;
    } temperatures[2];
};

/* A function whose checks no caller takes away, as motord's. */
#define OF_ITS_OWN __attribute__((noipa))
#define KEEP(pointer) __asm__ volatile("" ::"r"(pointer) : "memory")

/* The codes of one unit, the size of one code, where zero lies, and the largest code. */
struct scale {
    double codes, step, zero, largest;
};

struct scales {
    struct scale position, velocity, kp, kd, torque;
};

static struct scale scale(double min, double max, double largest)
{
    double span = max - min;
    return (struct scale){ largest / span, span / largest, largest * (-min / span), largest };
}

static inline uint64_t code(double value, struct scale scale)
{
    double code = value * scale.codes + scale.zero;
    code = code > 0 ? code : 0;
    code = code < scale.largest ? code : scale.largest;
    return (uint64_t)(int64_t)(code + 0.5);
}

static inline float value(uint64_t code, struct scale scale)
{
    return (float)(((double)(int64_t)code - scale.zero) * scale.step);
}

OF_ITS_OWN static int encode(const struct impedance *wanted, const struct scales *scales, uint8_t bytes[8])
{
    if (!isfinite((double)wanted->position + wanted->velocity + wanted->kp + wanted->kd + wanted->torque))
        return -1;
    uint64_t word = code(wanted->position, scales->position) << 48 | code(wanted->velocity, scales->velocity) << 36 |
                    code(wanted->kp, scales->kp) << 24 | code(wanted->kd, scales->kd) << 12 | code(wanted->torque, scales->torque);
    if (word >> 16 == 0xFFFFFFFFFFFF)
        word -= (uint64_t)1 << 24;
    else if (word == 0)
        word = (uint64_t)1 << 48;
    word = __builtin_bswap64(word);
    memcpy(bytes, &word, 8);
    return 0;
}

OF_ITS_OWN static int decode(const uint8_t *bytes, size_t count, const struct scales *scales, struct state *state)
{
    if (count < 6 || count > 8)
        return -1;
    state->id = bytes[0];
    state->has_status = 0;
    state->temperatures[0].is_known = state->temperatures[1].is_known = 0;
    state->codes[0] = (uint16_t)(bytes[1] << 8 | bytes[2]);
    state->codes[1] = (uint16_t)(bytes[3] << 4 | bytes[4] >> 4);
    state->codes[2] = (uint16_t)((bytes[4] & 15) << 8 | bytes[5]);
    state->position = value(state->codes[0], scales->position);
    state->velocity = value(state->codes[1], scales->velocity);
    state->torque = value(state->codes[2], scales->torque);
    return 0;
}

static uint32_t seed = 1;

static float between(float low, float high)
{
    seed = seed * 1664525 + 1013904223;
    return low + (high - low) * ((float)(seed >> 8) / 16777216.0F);
}

static uint64_t sum = 14695981039346656037U;

static void add(const void *bytes, size_t count)
{
    for (size_t place = 0; place < count; place++)
        sum = (sum ^ ((const uint8_t *)bytes)[place]) * 1099511628211U;
}

int main(int count, char **arguments)
{
    static struct impedance wanted[DISTINCT];
    static uint8_t bytes[DISTINCT][8], replies[DISTINCT][6];
    require(count == 2, "usage: codec FRAMES");
    size_t frames = strtoul(arguments[1], NULL, 10);
    double full_scale = 225 * 0.125 * 8, best[2] = { INFINITY, INFINITY };
    struct scales scales = { scale(-12.5, 12.5, 65535), scale(-65, 65, 4095), scale(0, 500, 4095), scale(0, 5, 4095),
                             scale(-full_scale, full_scale, 4095) };
    KEEP(&scales);
    for (size_t frame = 0; frame < DISTINCT; frame++) {
        wanted[frame].position = between(-13, 13);
        wanted[frame].velocity = between(-66, 66);
        wanted[frame].kp = between(-1, 501);
        wanted[frame].kd = between(-0.1F, 5.1F);
        wanted[frame].torque = between(-230, 230);
        require(encode(&wanted[frame], &scales, bytes[frame]) == 0, "encode");
        replies[frame][0] = 1;
        memcpy(&replies[frame][1], bytes[frame], 5);
    }
    for (int run = 0; run < RUNS; run++) {
        double begun = now_ns();
        for (size_t frame = 0; frame < frames; frame++) {
            uint8_t out[8];
            KEEP(&wanted[frame % DISTINCT]);
            encode(&wanted[frame % DISTINCT], &scales, out);
            KEEP(out);
        }
        double middle = now_ns();
        for (size_t frame = 0; frame < frames; frame++) {
            struct state state;
            KEEP(&replies[frame % DISTINCT]);
            decode(replies[frame % DISTINCT], 6, &scales, &state);
            KEEP(&state);
        }
        double times[2] = { (middle - begun) / (double)frames, (now_ns() - middle) / (double)frames };
        for (int way = 0; way < 2; way++)
            best[way] = times[way] < best[way] ? times[way] : best[way];
    }
    for (size_t frame = 0; frame < DISTINCT; frame++) {
        struct state state;
        decode(replies[frame], 6, &scales, &state);
        add(bytes[frame], 8);
        add(&state.position, 4), add(&state.velocity, 4), add(&state.torque, 4);
    }
    printf("c-encode %.2f %.2f\nc-decode %.2f %.2f\nc-sum %016llx\n", best[0], best[0], best[1], best[1], (unsigned long long)sum);
}

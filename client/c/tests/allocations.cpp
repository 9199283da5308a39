// Counts what a loop of a controller allocates: wait, read and send, after the first cycles. Prints the median time of a send and the
// share of late setpoints.
//
//   allocations [INSTANCE [GROUP [SECONDS]]]
//
// An exit status of 1 means that the loop allocated or freed memory.

#include <motord.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <new>

extern "C" {
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
void *__libc_memalign(size_t, size_t);
void __libc_free(void *);
}

namespace {

thread_local bool counts = false;
thread_local unsigned long allocations = 0;

void note() noexcept {
    if (counts) ++allocations;
}

double now_us() {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return std::chrono::duration<double, std::micro>(now).count();
}

} // namespace

// Every allocation of the process: the library's too.
extern "C" {
void *malloc(size_t size) noexcept { return note(), __libc_malloc(size); }
void *calloc(size_t count, size_t size) noexcept { return note(), __libc_calloc(count, size); }
void *realloc(void *memory, size_t size) noexcept { return note(), __libc_realloc(memory, size); }
void *aligned_alloc(size_t alignment, size_t size) noexcept { return note(), __libc_memalign(alignment, size); }
int posix_memalign(void **memory, size_t alignment, size_t size) noexcept {
    note();
    return (*memory = __libc_memalign(alignment, size)) ? 0 : 12;
}
void free(void *memory) noexcept {
    if (memory) note();
    __libc_free(memory);
}
}

int main(int argc, char **argv) {
    const double seconds = argc > 3 ? std::atof(argv[3]) : 10.0;
    try {
        const motord::Client client(argc > 1 ? argv[1] : "demo");
        motord::Claim claim(client, argc > 2 ? argv[2] : "legs");
        motord::State state;
        claim.wait_for(MOTORD_PHASE_DISARMED);
        client.wait(state);
        claim.hold(state, 20.0, 0.5);
        claim.commit();
        claim.enable();
        claim.wait_for(MOTORD_PHASE_ACTIVE);
        const auto count = claim.size();
        std::vector<double> held(count), position(count), kp(count, 20.0), kd(count, 0.5), times;
        client.wait(state);
        state.read(claim, MOTORD_QUANTITY_POSITION, held);
        const auto cycles = static_cast<std::size_t>(seconds * 1000.0);
        times.reserve(cycles + 200);
        motord_group first{}, last{};
        for (std::size_t cycle = 0; cycle < cycles + 100; ++cycle) {
            if (cycle == 100) {
                first = state.group(claim);
                counts = true;
            }
            client.wait(state);
            claim.must_be_active(state);
            state.read(claim, MOTORD_QUANTITY_POSITION, position);
            last = state.group(claim);
            const double begun = now_us();
            claim.send({held.data(), nullptr, kp.data(), kd.data(), nullptr}, count);
            if (cycle >= 100) times.push_back(now_us() - begun);
        }
        counts = false;
        std::sort(times.begin(), times.end());
        const double accepted = last.accepted - first.accepted, late = last.late - first.late;
        std::printf("C++: %zu cycles, send p50 %.2f us, p99 %.2f us, late %.2f %%, %lu allocations\n", times.size(),
                    times[times.size() / 2], times[times.size() * 99 / 100], accepted > 0 ? 100.0 * late / accepted : 0.0,
                    allocations);
        return allocations == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
    } catch (const motord::Error &error) {
        counts = false;
        std::fprintf(stderr, "allocations: %s\n", error.what());
        return 2;
    }
}

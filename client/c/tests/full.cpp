// A state that the library cannot create is an exception.

#include <motord.hpp>

#include <cstdio>
#include <cstdlib>

/// Takes the place of the library's function, which returns null while 65 536 states exist.
motord_state *motord_state_new(void) { return nullptr; }

int main() {
    try {
        const motord::State state;
    } catch (const motord::Error &error) {
        if (error.status() == MOTORD_STATUS_UNAVAILABLE)
            return EXIT_SUCCESS;
    }
    std::fprintf(stderr, "full: there is a state without an object\n");
    return EXIT_FAILURE;
}

// Stops a robot some of whose motors do not answer: a stop must name them, and be no success.
//
//   offline INSTANCE JOINT...

#include <motord.hpp>

#include <cstdio>
#include <cstdlib>

namespace {

using Names = std::vector<std::string>;

/// The names by the functions of C.
Names of_c(const std::string &instance) {
    Names names;
    if (motord_emergency_stop(instance.c_str()) != MOTORD_STATUS_MOTORS_OFFLINE) return names;
    for (size_t index = 0; const char *name = motord_error_joint(index); ++index)
        names.emplace_back(name);
    return names;
}

/// The names by the exception of C++.
Names of_client(const motord::Client &client) {
    try {
        client.emergency_stop();
    } catch (const motord::MotorsOffline &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return error.joints();
    }
    return {};
}

} // namespace

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    const Names expected(argv + 2, argv + argc);
    try {
        const motord::Client client(argv[1]);
        if (of_c(argv[1]) == expected && of_client(client) == expected) return EXIT_SUCCESS;
        std::fprintf(stderr, "offline: the names are others: %s\n", motord_error_message());
    } catch (const motord::Error &error) {
        std::fprintf(stderr, "offline: %s\n", error.what());
    }
    return EXIT_FAILURE;
}

/* Calls libmotord.a and another Rust library of the same program. C, and C++ without exceptions. */

#include <motord.h>
#include <string.h>

#ifdef __cplusplus
extern "C" int other_library(void);
#else
int other_library(void);
#endif

int main(void) {
    motord_client *client = NULL;
    if (other_library() != 3) return 1;
    if (motord_connect("none", &client) != MOTORD_STATUS_NOT_RUNNING) return 2;
    return strstr(motord_error_message(), "no motord runs") == NULL;
}

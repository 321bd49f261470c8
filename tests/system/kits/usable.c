/* Reads status words and prints 1 for each with which a fresh pose is usable, otherwise 0. */
#include "trifacet.h"

#include <inttypes.h>
#include <stdio.h>

int main(void)
{
    struct trifacet_frame frame;
    memset(&frame, 0, sizeof frame);
    while (scanf("%" SCNu32, &frame.status) == 1) {
        printf("%d\n", trifacet_usable(&frame, 0, 1));
    }
    return 0;
}

/* Decodes datagrams, each preceded by its length (u16), and prints every field, with floating-point numbers as bits. */
#include "trifacet.h"

#include <inttypes.h>
#include <stdio.h>

static void print_doubles(const char *name, const double *x, int count)
{
    printf(", \"%s\": [", name);
    for (int i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, &x[i], sizeof bits);
        printf("%s%" PRIu64, i ? ", " : "", bits);
    }
    printf("]");
}

static void print_float(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    printf("%" PRIu32, bits);
}

static void print_floats(const char *name, const float *x, int count)
{
    printf(", \"%s\": [", name);
    for (int i = 0; i < count; i++) {
        printf("%s", i ? ", " : "");
        print_float(x[i]);
    }
    printf("]");
}

static void print_frame(const struct trifacet_frame *f)
{
    printf("{\"session\": %" PRIu32 ", \"config\": %" PRIu32 ", \"sequence\": %" PRIu64, f->session, f->config,
           f->sequence);
    printf(", \"sample_index\": %" PRIu64 ", \"time_ns\": %" PRId64, f->sample_index, f->time_ns);
    printf(", \"solve_delay_ns\": %" PRIu32 ", \"send_delay_ns\": %" PRIu32, f->solve_delay_ns, f->send_delay_ns);
    printf(", \"status\": %" PRIu32 ", \"clock_quality\": %u", f->status, (unsigned)f->clock_quality);
    printf(", \"lock\": %u, \"iterations\": %u", (unsigned)f->lock, (unsigned)f->iterations);
    printf(", \"averaged\": %u, \"lost\": %u", (unsigned)f->averaged, (unsigned)f->lost);
    print_doubles("position", f->position, 3);
    print_doubles("rotation", f->rotation, 3);
    print_floats("sd_position", f->sd_position, 3);
    print_floats("sd_rotation", f->sd_rotation, 3);
    print_floats("beam_offset", f->beam_offset, 2);
    print_floats("spot_a", f->spot_a, 2);
    print_floats("spot_b", f->spot_b, 2);
    print_floats("spot_c", f->spot_c, 2);
    const struct { const char *name; float x; } singles[] = {
        {"steering_residual", f->steering_residual}, {"power_a", f->power_a}, {"power_b", f->power_b},
        {"power_c", f->power_c}, {"steering_x", f->steering_x}, {"steering_y", f->steering_y},
    };
    for (size_t i = 0; i < sizeof singles / sizeof *singles; i++) {
        printf(", \"%s\": ", singles[i].name);
        print_float(singles[i].x);
    }
    printf("}\n");
}

int main(void)
{
    static const char *errors[] = {"", "bytes", "TFP1", "version", "CRC", "lock state"};
    uint8_t length[2];
    while (fread(length, 1, sizeof length, stdin) == sizeof length) {
        static uint8_t bytes[65536];
        size_t size = trifacet_u16(length);
        if (fread(bytes, 1, size, stdin) != size)
            return 1;
        struct trifacet_frame frame;
        enum trifacet_result result = trifacet_decode(&frame, bytes, size);
        if (result == TRIFACET_OK)
            print_frame(&frame);
        else
            printf("{\"error\": \"%s\"}\n", errors[result]);
    }
    return 0;
}

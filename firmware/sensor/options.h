/* The parameters of the sensor and of the board around it, with the values of a healthy one. On the host they are
 * arguments, `key=value`. */
#ifndef TF_OPTIONS_H
#define TF_OPTIONS_H

#include "real.h"

/* Key, default, meaning. Faults act from the scan `at` on unless their text says otherwise. */
#define OPTIONS(X)                                                                                                     \
    X(seed, 1, "of the noise")                                                                                         \
    X(bits, 18, "resolution of the converter")                                                                         \
    X(range_mv, 10000, "range of the converter, millivolts")                                                           \
    X(spot_um, 1.08, "noise of each spot coordinate, standard deviation")                                              \
    X(power_noise, 0.001, "noise of each power, relative standard deviation")                                          \
    X(readback_um, 0.1, "noise of the readback, standard deviation")                                                   \
    X(motion, 1, "factor of the motion of the mirror; 0: at rest")                                                     \
    X(skew_us, 0, "time from one channel of the converter to the next")                                                \
    X(at, 0, "sequence number of the first scan with faults")                                                          \
    X(until, 4294967296.0, "sequence number of the first scan without faults")                                         \
    X(tick_step, 0, "error of the tick of scan `at` only, ticks")                                                      \
    X(minor, 1, "minor version of the protocol: 0 or 1")                                                               \
    X(boot, 1, "boot id")                                                                                              \
    X(wide, 0, "1: the tick of version 1.1 has 64 bits")                                                               \
    X(mute, 0, "the board sends no answer of this type: 131 for ACK, 133 for ERROR")                                   \
    X(wrong_ids, 0, "1: the board acknowledges other ids")                                                             \
    X(no_lease, 0, "1: leases never expire")                                                                           \
    X(no_park, 0, "1: the outputs hold where they should park")                                                        \
    X(keep_number, 0, "1: START continues the numbers of the scans")                                                   \
    X(rate_factor, 1, "the board samples at this multiple of the rate that it replies")                                \
    X(new_boots, 0, "1: each IDENTITY states another boot id")                                                         \
    X(no_applied, 0, "1: no command is stated as applied")                                                             \
    X(line_ms, 0, "delay of the bytes from the host, milliseconds")                                                    \
    X(tick_bits, 64, "the tick wraps at this width, although the protocol requires another one")                       \
    X(tick_factor, 1, "the tick advances by this multiple of the clock; 0: it stops")                                  \
    X(clock_ppm, 0, "the clock of the board is too slow by this part; from power-up on")                               \
    X(freeze, 0, "channels that repeat their code: sum of 1 for channel 0, 2 for 1, 4 for 2 ...")                      \
    X(sequence_jump, 0, "numbers that are omitted before scan `at`")                                                   \
    X(psd_um, 0, "PSD A is displaced by this distance against its u-axis")                                             \
    X(pitch_urad, 0, "constant rotation of the mirror about y; from power-up on")                                      \
    X(block_at, 4294967296.0, "sequence number of the first scan in which the laser is blocked")                       \
    X(block_until, 4294967296.0, "sequence number of the first scan in which it is free again")                        \
    X(ambient, 0, "ambient light on each PSD, part of a third of the laser power")                                     \
    X(ambient_a, 0, "more of it on PSD A only")                                                                        \
    X(power, 1, "factor of the laser power")                                                                           \
    X(fade_s, 0, "time in which the power changes to this factor, seconds")                                            \
    X(flicker, 0, "amplitude of a sine of the laser power, relative")                                                  \
    X(flicker_hz, 100, "its frequency")                                                                                \
    X(polarity, 1, "the stage moves by this multiple of the command")                                                  \
    X(readback_stuck, 0, "1: the readback keeps its value")                                                            \
    X(laser_um, 0, "the laser is displaced by this distance along x")                                                  \
    X(chip_um, 0, "no light comes from the mirror within this distance of the apex")                                   \
    X(duplicate, 0, "part of the scans that is sent twice")                                                            \
    X(swap, 0, "part of the scans that is sent after its successor")                                                   \
    X(damage, 0, "part of the scans with a wrong bit")

/* The values of all keys. */
typedef struct {
#define FIELD(name, value, text) real name;
    OPTIONS(FIELD)
#undef FIELD
} options;

/* The values of a healthy board: `{OPTIONS(OPTION_DEFAULT)}`. */
#define OPTION_DEFAULT(name, value, text) (real)(value),

/* Reads the arguments (host/options.c). Ends the program with a message if one of them is not allowed. */
options options_read(int count, char **arguments);

#endif

/* The codec of the core, line by line, to compare it with another one.
 *
 * A line of input is a command with its numbers or bytes in hexadecimal; the answer is one line:
 *
 *     receive HEX       bytes of the line -> the messages in them (hex), or "damaged", separated by spaces
 *     request MINOR HEX a message of the host -> its name and its fields, or "error REASON"
 *     frame HEX         a message -> its frame
 *     board TIME HEX    a board receives bytes at this time (microseconds since power-up): its frames, outputs x and y, 1
 *                       if the lease has expired; from line to line the same board, of one sample rate (1 kHz)
 *     power_up MINOR    the board is switched on and speaks this minor version
 *     scans COUNT       the board takes this number of scans
 *     identity TICK BITS OUTPUT_BITS RANGE SLOWEST FASTEST SIMULATED COUNT (ROLE SKEW)... HOST MINOR WIDE BOOT UNITS
 *              (CHANNEL UNIT SCALE EXPONENT ZERO)... NAME
 *     reply REQUEST RESULT RATE
 *     ack ID RESULT
 *     scan SEQUENCE TICK STATUS COUNT CODE...
 *     long_scan SEQUENCE TICK STATUS APPLIED COUNT CODE...
 *     error REASON TYPE -> the frame
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../core/board.h"

#define LONGEST 20000

static void print_hex(const uint8_t *bytes, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        printf("%02x", bytes[i]);
    }
}

static size_t read_hex(const char *text, uint8_t *bytes)
{
    size_t length = 0;
    unsigned byte;
    while (sscanf(text + 2 * length, "%2x", &byte) == 1) {
        bytes[length++] = (uint8_t)byte;
    }
    return length;
}

static void print_frame(const uint8_t *message, size_t length)
{
    uint8_t frame[TF_MAX_FRAME] = {0};
    size_t bytes = tf_frame_encode(message, length, frame);
    print_hex(frame, bytes);
}

static void receive(const uint8_t *bytes, size_t length)
{
    tf_receiver receiver = {.received = 0};
    for (size_t i = 0; i < length; i++) {
        tf_frame_event event = tf_frame_receive(&receiver, bytes[i]);
        if (event == TF_FRAME_MESSAGE) {
            print_hex(receiver.bytes, receiver.length);
            putchar(' ');
        } else if (event == TF_FRAME_DAMAGED) {
            fputs("damaged ", stdout);
        }
    }
}

static void request(uint8_t minor, const uint8_t *bytes, size_t length)
{
    tf_request r;
    uint8_t reason = tf_request_read(bytes, length, minor, &r);
    if (reason != 0) {
        printf("error %u", reason);
    } else if (r.type == TF_START) {
        printf("start %" PRIu32 " %" PRId32 " %" PRId32 " %u", r.rate_mhz, r.codes[0], r.codes[1], r.minor);
    } else if (r.type == TF_STEER) {
        printf("steer %" PRIu32 " %" PRId32 " %" PRId32 " %u %d", r.id, r.codes[0], r.codes[1], r.lease_ms, r.park);
    } else if (r.type == TF_STOP) {
        fputs("stop", stdout);
    } else {
        printf("identify %u", r.minor);
    }
}

/* The bytes of the last word of the line. */
static size_t rest(uint8_t *bytes)
{
    const char *text = strtok(NULL, " \n");
    return text == NULL ? 0 : read_hex(text, bytes);
}

/* The next number of the line. */
static int64_t number(void)
{
    const char *word = strtok(NULL, " \n");
    return word == NULL ? 0 : strtoll(word, NULL, 10);
}

/* The next number of the line, up to 2^64 - 1. */
static uint64_t large_number(void)
{
    const char *word = strtok(NULL, " \n");
    return word == NULL ? 0 : strtoull(word, NULL, 10);
}

static size_t identity(uint8_t *message)
{
    tf_identity id = {.tick_hz = 0};
    id.tick_hz = (uint32_t)number();
    id.converter_bits = (uint8_t)number();
    id.output_bits = (uint8_t)number();
    id.range_mv = (uint32_t)number();
    id.slowest_mhz = (uint32_t)number();
    id.fastest_mhz = (uint32_t)number();
    id.simulated = number() != 0;
    id.channels = (uint8_t)number();
    for (unsigned i = 0; i < id.channels && i < TF_MAX_CHANNELS; i++) {
        id.channel[i].role = (uint8_t)number();
        id.channel[i].skew_ns = (uint32_t)number();
    }
    uint8_t host = (uint8_t)number();
    id.minor = (uint8_t)number();
    id.wide_tick = number() != 0;
    id.boot_id = (uint32_t)number();
    id.units = (uint8_t)number();
    for (unsigned i = 0; i < id.units && i < TF_MAX_UNITS; i++) {
        id.unit[i].channel = (uint8_t)number();
        id.unit[i].unit = (uint8_t)number();
        id.unit[i].scale = (int32_t)number();
        id.unit[i].exponent = (int8_t)number();
        id.unit[i].zero = (int32_t)number();
    }
    const char *name = strtok(NULL, "\n");
    id.name = name == NULL ? "" : name;
    return tf_write_identity(message, &id, host);
}

static void codes_of(uint8_t count, int32_t codes[TF_MAX_CHANNELS])
{
    for (unsigned i = 0; i < count && i < TF_MAX_CHANNELS; i++) {
        codes[i] = (int32_t)number();
    }
}

static size_t long_scan(uint8_t *message)
{
    uint32_t sequence = (uint32_t)number();
    uint64_t tick = large_number();
    uint8_t status = (uint8_t)number();
    uint32_t applied = (uint32_t)number();
    uint8_t count = (uint8_t)number();
    int32_t codes[TF_MAX_CHANNELS] = {0};
    codes_of(count, codes);
    return tf_write_long_scan(message, sequence, tick, status, applied, codes, count);
}

static size_t scan(uint8_t *message)
{
    uint32_t sequence = (uint32_t)number(), tick = (uint32_t)number();
    uint8_t status = (uint8_t)number(), count = (uint8_t)number();
    int32_t codes[TF_MAX_CHANNELS] = {0};
    codes_of(count, codes);
    return tf_write_scan(message, sequence, tick, status, codes, count);
}

static void converse(tf_board *board, uint8_t *bytes)
{
    uint64_t now = (uint64_t)number();
    tf_board_check_lease(board, now);
    size_t length = rest(bytes);
    for (size_t i = 0; i < length; i++) {
        tf_board_receive(board, bytes[i], now);
    }
    uint8_t byte;
    for (; tf_board_waiting(board, &byte); tf_board_sent(board)) {
        print_hex(&byte, 1);
    }
    printf(" %" PRId32 " %" PRId32 " %d", board->outputs[0], board->outputs[1], board->lease_expired);
}

static tf_identity one_rate = {.tick_hz = 1000000, .output_bits = 16, .slowest_mhz = 1000000,
                               .fastest_mhz = 1000000, .name = "", .minor = TF_MINOR};

static void power_up(tf_board *board)
{
    one_rate.minor = (uint8_t)number();
    tf_board_init(board, &one_rate);
}

static void scans(tf_board *board)
{
    const int32_t codes[TF_MAX_CHANNELS] = {0};
    uint64_t tick;
    for (int64_t count = number(); count > 0 && tf_board_next_scan(board, &tick); count--) {
        tf_board_scan(board, tick, codes, 0);
    }
}

/* Writes the answer of the board that a command describes. */
static size_t answer(const char *command, uint8_t *message)
{
    if (strcmp(command, "identity") == 0) {
        return identity(message);
    }
    if (strcmp(command, "scan") == 0) {
        return scan(message);
    }
    if (strcmp(command, "long_scan") == 0) {
        return long_scan(message);
    }
    int64_t first = number(), second = number();
    if (strcmp(command, "reply") == 0) {
        return tf_write_reply(message, (uint8_t)first, (uint8_t)second, (uint32_t)number());
    }
    if (strcmp(command, "ack") == 0) {
        return tf_write_ack(message, (uint32_t)first, (uint8_t)second);
    }
    if (strcmp(command, "error") == 0) {
        return tf_write_error(message, (uint8_t)first, (uint8_t)second);
    }
    fprintf(stderr, "unknown command \"%s\"\n", command);
    exit(64);
}

int main(void)
{
    static char line[LONGEST];
    static uint8_t bytes[LONGEST];
    static tf_board board;
    tf_board_init(&board, &one_rate);
    while (fgets(line, sizeof line, stdin) != NULL) {
        const char *command = strtok(line, " \n");
        if (command == NULL) {
            continue;
        }
        uint8_t message[TF_MAX_BODY];
        if (strcmp(command, "board") == 0) {
            converse(&board, bytes);
        } else if (strcmp(command, "power_up") == 0) {
            power_up(&board);
        } else if (strcmp(command, "scans") == 0) {
            scans(&board);
        } else if (strcmp(command, "receive") == 0) {
            receive(bytes, rest(bytes));
        } else if (strcmp(command, "request") == 0) {
            uint8_t minor = (uint8_t)number();
            request(minor, bytes, rest(bytes));
        } else if (strcmp(command, "frame") == 0) {
            print_frame(bytes, rest(bytes));
        } else {
            print_frame(message, answer(command, message));
        }
        putchar('\n');
    }
    return 0;
}

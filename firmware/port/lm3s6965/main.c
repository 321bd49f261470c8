/* The reference firmware on an LM3S6965, as QEMU emulates it (-M lm3s6965evb). The converter, the outputs and the head
 * are a model in C: this chip has no converter that would do. */
#include "../../core/serve.h"
#include "../../sensor/sensor.h"
#include "hardware.h"

#define OUTPUT_BITS 16
static const real FULL_SCALE_M = (real)500e-6; /* position of the stage at the full-scale code */

static const options OPTIONS_OF_MODEL = {OPTIONS(OPTION_DEFAULT)};
static sensor model = {.random = 1};
static tf_board board;
static int32_t outputs[2];
static bool line_used; /* a byte has arrived since power-up */

#define ROLES_OF(psd) {TF_ROLE_U + (psd), 0}, {TF_ROLE_V + (psd), 0}, {TF_ROLE_SUM + (psd), 0}
static tf_identity identity = {
    .tick_hz = SYSTEM_HZ,
    .converter_bits = 18,
    .output_bits = OUTPUT_BITS,
    .range_mv = 10000,
    .slowest_mhz = 1000,
    .fastest_mhz = 500000,
    .simulated = true,
    .channels = SENSOR_CHANNELS,
    .channel = {ROLES_OF(0), ROLES_OF(1), ROLES_OF(2), {TF_ROLE_READBACK, 0}, {TF_ROLE_READBACK + 1, 0}},
    .name = "trifacet reference firmware 1.1, LM3S6965, simulated head",
    .minor = TF_MINOR,
    .wide_tick = true,
};

uint64_t tf_port_now(void)
{
    return hardware_now();
}

uint8_t tf_port_sample(uint64_t *tick, int32_t *codes)
{
    (void)tick; /* the model samples exactly when it should */
    real position[2];
    for (int axis = 0; axis < 2; axis++) {
        position[axis] = (real)outputs[axis] * FULL_SCALE_M / (1 << (OUTPUT_BITS - 1));
    }
    real period_s = (real)board.period / SYSTEM_HZ;
    const int32_t *sampled = sensor_scan(&model, &OPTIONS_OF_MODEL, board.sequence, period_s, position);
    for (int channel = 0; channel < SENSOR_CHANNELS; channel++) {
        codes[channel] = sampled[channel];
    }
    return 0;
}

void tf_port_output(const int32_t codes[2])
{
    outputs[0] = codes[0];
    outputs[1] = codes[1];
}

bool tf_port_receive(uint8_t *byte)
{
    if (!hardware_receive(byte)) {
        return false;
    }
    if (!line_used) {
        line_used = true;
        identity.boot_id = (uint32_t)hardware_now(); /* random: the host does not know the clock of the board */
    }
    return true;
}

bool tf_port_send(uint8_t byte)
{
    return hardware_send(byte);
}

int main(void)
{
    hardware_init();
    tf_board_init(&board, &identity);
    for (;;) {
        if (!tf_serve(&board)) {
            hardware_sleep();
        }
    }
}

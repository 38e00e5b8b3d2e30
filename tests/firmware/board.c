/* The carriages and switches around a simulated board; linked with a firmware's own simulator.

   Counts the pulses at the step outputs, whatever the firmware believes, and closes a switch where a
   carriage has come so far. Both stand in a file that a test maps into its memory: GLIDECAL_BOARD
   names it. Knows the simulators by the names of their outputs only; the linker puts it between
   (--wrap). Where firmware and hardware run as two threads without a lock, which no board does, it
   makes whole again what is one step on a board: flags that are set and cleared, the end of a line;
   and its clock waits for firmware that a busy computer leaves waiting while the motors run. */

/* first: the standard headers make names of members into macros */
#ifdef GRBL_HAL
#include "mcu.h"
#include "driver.h"
#include "simulator.h"
#include "grbl/hal.h"
#else
#include "simulator.h"
#include "avr/io.h"
#endif

#include <fcntl.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#ifdef __linux__
#include <sys/prctl.h>
#endif
#include <time.h>
#include <unistd.h>

enum { CARRIAGES = 3, ALL = 7 };
enum { HOLD = 1, RESET = 2, START = 4, ESTOP = 8 };

typedef struct {
    volatile int32_t pulses[CARRIAGES];    /* since the power came on, forwards less backwards */
    volatile int32_t turns;                /* one more with every pulse, in any direction */
    volatile int32_t switch_at[CARRIAGES]; /* from the test: closed at so many pulses and below */
    volatile int32_t pressed;              /* from the test: keys of the panel */
} board_t;

static board_t *board;

void __real_grbl_per_tick(void);
void __wrap_grbl_per_tick(void);
void __real_st_prep_buffer(void);
void __wrap_st_prep_buffer(void);

static void count(uint8_t carriages, uint8_t backwards)
{
    for (int k = 0; k < CARRIAGES; k++)
        if (carriages >> k & 1)
            board->pulses[k] += backwards >> k & 1 ? -1 : 1;
    if (carriages)
        board->turns++;
}

#ifdef GRBL_HAL

void __real_mcu_gpio_set(gpio_port_t *port, uint16_t pins, uint16_t mask);
void __wrap_mcu_gpio_set(gpio_port_t *port, uint16_t pins, uint16_t mask);

void __wrap_mcu_gpio_set(gpio_port_t *port, uint16_t pins, uint16_t mask)
{
    __real_mcu_gpio_set(port, pins, mask);
    if (port == &gpio[STEP_PORT0])
        count(pins & mask & ALL, gpio[DIR_PORT].state.value & ALL);
}

static void set_bits(volatile uint_fast16_t *flags, uint_fast16_t bits)
{
    __atomic_fetch_or(flags, bits, __ATOMIC_SEQ_CST);
}

static uint_fast16_t clear_bits(volatile uint_fast16_t *flags, uint_fast16_t bits)
{
    return __atomic_fetch_and(flags, ~bits, __ATOMIC_SEQ_CST);
}

static uint_fast16_t set_value(volatile uint_fast16_t *flags, uint_fast16_t value)
{
    return __atomic_exchange_n(flags, value, __ATOMIC_SEQ_CST);
}

static void look(void)
{
    if (hal.set_bits_atomic && hal.set_bits_atomic != set_bits) {
        hal.set_bits_atomic = set_bits;
        hal.clear_bits_atomic = clear_bits;
        hal.set_value_atomic = set_value;
    }
    uart.tx_irq_enable = 1; /* or the rest of a line waits for the next one */
}

/* The firmware's loop gives way here, and takes a whole processor if that is all it does. */
int __wrap_sched_yield(void);
int __wrap_sched_yield(void)
{
    struct timespec moment = {0, 20000};
    return nanosleep(&moment, NULL);
}

static void at_rest(void) {}

static int motors_run(void) { return timer[STEPPER_TIMER].enable; }

static void close_switches(uint8_t closed) { mcu_gpio_in(&gpio[LIMITS_PORT0], closed, ALL); }

static void press(int32_t pressed)
{
    uint16_t pins = (pressed & HOLD ? FEED_HOLD_BIT : 0) | (pressed & RESET ? RESET_BIT : 0)
                  | (pressed & START ? CYCLE_START_BIT : 0) | (pressed & ESTOP ? ESTOP_BIT : 0);
    mcu_gpio_in(&gpio[CONTROL_PORT], pins, FEED_HOLD_BIT | RESET_BIT | CYCLE_START_BIT | ESTOP_BIT);
}

#else

/* What is connected to an Uno: port D steps at 2, 3, 4 and turns at 5, 6, 7; switches at B 1, 2, 4 and
   keys at C 0, 1, 2 are pulled up, and pulled to ground where they are closed. */

void interrupt_CONTROL_INT_vect(void); /* the simulator calls neither of them */
void interrupt_LIMIT_INT_vect(void);

extern volatile uint8_t sys_rt_exec_state;
void __wrap_system_set_exec_state_flag(uint8_t mask);
void __wrap_system_clear_exec_state_flag(uint8_t mask);

void __wrap_system_set_exec_state_flag(uint8_t mask)
{
    __atomic_fetch_or(&sys_rt_exec_state, mask, __ATOMIC_SEQ_CST);
}

void __wrap_system_clear_exec_state_flag(uint8_t mask)
{
    __atomic_fetch_and(&sys_rt_exec_state, (uint8_t)~mask, __ATOMIC_SEQ_CST);
}

/* A line leaves at 115200 baud: whoever answers its last byte at once is not earlier than its end. */
enum { WAITING = 4096, BYTE_TICKS = F_CPU / 11520 };
static uint8_t waiting[WAITING];
static unsigned arrived, sent, ticks;
void __real_sim_serial_out(uint8_t byte);
void __wrap_sim_serial_out(uint8_t byte);

/* Between the firmware's last byte and its wish to be asked for one, the simulator may have taken that
   byte: then it asks for one that is not there, and gets what was said long ago. */
extern uint8_t serial_tx_buffer_head;
extern volatile uint8_t serial_tx_buffer_tail;
static int nothing_to_send;
void __real_interrupt_SERIAL_UDRE(void);
void __wrap_interrupt_SERIAL_UDRE(void);

void __wrap_interrupt_SERIAL_UDRE(void)
{
    nothing_to_send = serial_tx_buffer_tail == serial_tx_buffer_head;
    if (nothing_to_send)
        UCSR0B &= ~(1 << UDRIE0);
    else
        __real_interrupt_SERIAL_UDRE();
}

void __wrap_sim_serial_out(uint8_t byte)
{
    if (!nothing_to_send)
        waiting[arrived++ % WAITING] = byte;
}

static void look(void)
{
    static uint8_t before;
    uint8_t now = PORTD >> 2 & ALL;
    count(now & ~before, PORTD >> 5 & ALL);
    before = now;
    if (serial_tx_buffer_tail != serial_tx_buffer_head)
        UCSR0B |= 1 << UDRIE0;
    if (sent == arrived)
        ticks = 0;
    else if (++ticks >= BYTE_TICKS) {
        ticks = 0;
        __real_sim_serial_out(waiting[sent++ % WAITING]);
    }
}

static void at_rest(void) { PINB = PINC = 0xff; }

static int motors_run(void) { return TIMSK1 & 1 << OCIE1A; }

static void close_switches(uint8_t closed)
{
    PINB = 0xff & ~((closed & 1 ? 1 << 1 : 0) | (closed & 2 ? 1 << 2 : 0) | (closed & 4 ? 1 << 4 : 0));
    if (closed && (PCICR & 1 << PCIE0) && PCMSK0)
        interrupt_LIMIT_INT_vect();
}

static void press(int32_t pressed)
{
    PINC = 0xff & ~((pressed & RESET ? 1 : 0) | (pressed & HOLD ? 2 : 0) | (pressed & START ? 4 : 0));
    interrupt_CONTROL_INT_vect();
}

#endif

/* Before the simulator's main. One reads with getchar after select: nothing may wait in a buffer. */
__attribute__((constructor)) static void power_on(void)
{
    const char *name = getenv("GLIDECAL_BOARD");
    int file = name ? open(name, O_RDWR) : -1;
    if (file >= 0)
        board = mmap(NULL, sizeof *board, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (file < 0 || board == MAP_FAILED) {
        perror("GLIDECAL_BOARD");
        exit(2);
    }
    close(file);
#ifdef __linux__
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* a test that is killed leaves no board behind */
#endif
    setvbuf(stdin, NULL, _IONBF, 0);
    setvbuf(stdout, NULL, _IOLBF, 4096);
    at_rest();
}

static volatile unsigned prepared;

void __wrap_st_prep_buffer(void)
{
    __real_st_prep_buffer();
    prepared++;
}

/* What is prepared lasts for some 50 ms: firmware that did not run for 10 ms is waited for. */
static void wait_for_firmware(void)
{
    static unsigned before;
    static uint64_t since;
    struct timespec moment = {0, 100000};

    if (prepared != before || !motors_run()) {
        before = prepared;
        since = sim.masterclock;
    } else if (sim.masterclock - since > F_CPU / 100) {
        for (int patience = 0; patience < 5000 && prepared == before; patience++)
            nanosleep(&moment, NULL);
        since = sim.masterclock;
    }
}

void __wrap_grbl_per_tick(void)
{
    static int32_t turns_before = -1, pressed_before;
    static uint8_t closed_before;

    look();
    if (board->turns != turns_before) {
        uint8_t closed = 0;
        turns_before = board->turns;
        for (int k = 0; k < CARRIAGES; k++)
            closed |= (board->pulses[k] <= board->switch_at[k]) << k;
        if (closed != closed_before)
            close_switches(closed);
        closed_before = closed;
    }
    if (board->pressed != pressed_before)
        press(pressed_before = board->pressed);
    wait_for_firmware();
    __real_grbl_per_tick();
}

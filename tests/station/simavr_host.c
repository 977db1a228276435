/* Runs an ATmega328P program in simavr at real speed, its UART on a pty.
   Arguments: ELF file, then millivolts at A0, A1, ...; or ELF file, hx711 or ads1232, counts ... of its conversions in
   turn, the converter at D2 (data), D3 (clock), D4 (power). Prints the name of the pty. */
#define _XOPEN_SOURCE 600
#define _DEFAULT_SOURCE
#include <fcntl.h>
#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static int terminal;

static void on_byte(avr_irq_t *irq, uint32_t value, void *param) {
  char byte = (char)value;
  (void)irq, (void)param;
  if (write(terminal, &byte, 1) != 1) return; /* A host that does not read loses bytes, as on a real port. */
}

static int open_terminal(void) {
  int master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (master < 0 || grantpt(master) || unlockpt(master)) exit(1);
  int slave = open(ptsname(master), O_RDWR | O_NOCTTY); /* stays open, so the pty outlives its readers */
  struct termios settings;
  tcgetattr(slave, &settings);
  cfmakeraw(&settings);
  tcsetattr(slave, TCSANOW, &settings);
  return master;
}

/* A 24-bit converter with a two-wire port, 80 conversions a second, by the data sheets of Avia (HX711) and Texas
   Instruments (ADS1232, SBAS350F). Neither waits for a slow reader: a conversion in mid-read takes the bits away. */
enum { PERIOD = 16000000 / 80, HX711_OFF = 60 * 16, ADS1232_LOW = 26 * 16, DATA_PIN = 2, CLOCK_PIN = 3, POWER_PIN = 4 };

static struct {
  avr_t *avr;
  avr_irq_t *data;
  char **counts;
  int number, next, shifted, is_ads1232, is_on;
  int32_t value;
  avr_cycle_count_t due, risen, fallen;
} chip;

static void set_data(int level) { avr_raise_irq(chip.data, level); }

static void start(void) { /* The first conversion after power is settled four later. */
  chip.is_on = 1, chip.shifted = 25, chip.due = chip.avr->cycle + 4 * PERIOD;
  set_data(1);
}

static void on_clock(avr_irq_t *irq, uint32_t level, void *param) {
  (void)irq, (void)param;
  if (!level) {
    /* HX711: a clock that was high for 60 us has powered it down, and its fall powers it up. */
    if (!chip.is_ads1232 && chip.avr->cycle - chip.risen >= HX711_OFF) start();
    return;
  }
  chip.risen = chip.avr->cycle;
  if (!chip.is_on || chip.shifted > 24) return;
  chip.shifted++;
  set_data(chip.shifted == 25 ? 1 : chip.value >> (24 - chip.shifted) & 1);
}

static void on_power(avr_irq_t *irq, uint32_t level, void *param) {
  (void)irq, (void)param;
  if (!level) chip.is_on = 0, chip.fallen = chip.avr->cycle, set_data(1);
  else if (chip.avr->cycle - chip.fallen >= ADS1232_LOW) start();
}

static void convert(void) {
  if (!chip.is_on || chip.avr->cycle < chip.due) return;
  chip.due += PERIOD;
  chip.value = atoi(chip.counts[chip.next++ % chip.number]);
  chip.shifted = 0;
  set_data(0);
}

static void attach(avr_t *avr, char **arguments, int count) {
  chip.avr = avr, chip.is_ads1232 = !strcmp(arguments[0], "ads1232");
  chip.counts = arguments + 1, chip.number = count - 1;
  chip.data = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), DATA_PIN);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), CLOCK_PIN), on_clock, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), POWER_PIN), on_power, NULL);
  if (chip.is_ads1232) set_data(1); /* Without its sequence at power-up it does nothing. */
  else start();
}

static double now_s(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

int main(int count, char **arguments) {
  elf_firmware_t firmware = {0};
  avr_t *avr = avr_make_mcu_by_name("atmega328p");
  if (count < 2 || !avr || elf_read_firmware(arguments[1], &firmware)) return 1;
  avr_init(avr);
  firmware.frequency = 16000000;
  firmware.vcc = firmware.avcc = firmware.aref = 5000;
  avr_load_firmware(avr, &firmware);

  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~AVR_UART_FLAG_STDIO;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
  int is_converter = count > 3 && (!strcmp(arguments[2], "hx711") || !strcmp(arguments[2], "ads1232"));
  if (is_converter) attach(avr, arguments + 2, count - 2);
  for (int k = 2; k < count && !is_converter; k++)
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + k - 2), atoi(arguments[k]));

  terminal = open_terminal();
  printf("%s\n", ptsname(terminal));
  fflush(stdout);
  double start_s = now_s();
  for (;;) {
    avr_cycle_count_t until = avr->cycle + 16000;
    while (avr->cycle < until) {
      int state = avr_run(avr);
      if (is_converter) convert();
      if (state == cpu_Done || state == cpu_Crashed) return 1;
    }
    double ahead_s = avr->cycle / 16e6 - (now_s() - start_s);
    if (ahead_s > 0) usleep((useconds_t)(1e6 * ahead_s));
  }
}

/* Runs an ATmega328P program in simavr at real speed, its UART on a pty.
   Arguments: ELF file, then millivolts at A0, A1, ... Prints the name of the pty. */
#define _XOPEN_SOURCE 600
#define _DEFAULT_SOURCE
#include <fcntl.h>
#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
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
  for (int k = 2; k < count; k++)
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + k - 2), atoi(arguments[k]));

  terminal = open_terminal();
  printf("%s\n", ptsname(terminal));
  fflush(stdout);
  double start_s = now_s();
  for (;;) {
    avr_cycle_count_t until = avr->cycle + 16000;
    while (avr->cycle < until) {
      int state = avr_run(avr);
      if (state == cpu_Done || state == cpu_Crashed) return 1;
    }
    double ahead_s = avr->cycle / 16e6 - (now_s() - start_s);
    if (ahead_s > 0) usleep((useconds_t)(1e6 * ahead_s));
  }
}

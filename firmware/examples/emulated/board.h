/* What main.c needs of a board. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* Instructions (on an AVR cycles) of a thousand ticks. */
#ifndef PER_1000_TICKS
#define PER_1000_TICKS 1000
#endif

void board_start(void);
void board_print(const char *text);
uint32_t board_ticks(void);
uint32_t board_between(uint32_t start, uint32_t end);
uint32_t board_unused_stack(void); /* bytes never touched since board_start */
void board_stop(void);

#endif

// Sensor readout: 50 lines a second, `ms,adc[,adc ...]*checksum`, for an Arduino Uno or anything with its core.
//
// ms is the board's own clock at the moment of sampling: the host makes its time axis from it and from nothing else.
// The checksum is that of NMEA 0183, the exclusive-or of all bytes before the star, as two hex digits.
// Wiring: sensor between the supply and the analog pin, series resistor from the pin to ground.

#ifndef CHANNELS
#define CHANNELS 1  // analog pins A0, A1, ... ; up to 6 on an Uno
#endif

const uint32_t PERIOD_MS = 20;

static uint32_t due_ms;

void setup() {
  Serial.begin(115200);
  Serial.println(F("softcal readout 1"));
  due_ms = millis() + PERIOD_MS;
}

void loop() {
  // Subtraction goes on past the wrap of millis() after 49.7 days, comparison does not.
  const uint32_t late_ms = millis() - due_ms;
  if (late_ms & 0x80000000UL) return;
  if (late_ms >= PERIOD_MS) due_ms += late_ms;  // The line was blocked: leave a step, never shift the clock.

  char line[16 + 6 * CHANNELS];
  char *end = line + strlen(ultoa(due_ms, line, 10));
  for (uint8_t channel = 0; channel < CHANNELS; channel++) {
    *end++ = ',';
    end += strlen(itoa(analogRead(A0 + channel), end, 10));
  }
  uint8_t checksum = 0;
  for (const char *byte = line; byte < end; byte++) checksum ^= *byte;
  *end++ = '*';
  *end++ = "0123456789ABCDEF"[checksum >> 4];
  *end++ = "0123456789ABCDEF"[checksum & 15];
  *end = 0;
  Serial.println(line);
  due_ms += PERIOD_MS;
}

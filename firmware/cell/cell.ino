// Load cell behind a 24-bit bridge amplifier on two wires, HX711 or ADS1232: a line `ms,counts*checksum` a conversion.
//
// ms is the board's own clock when the conversion was ready. The checksum is that of NMEA 0183, as in readout.ino.
// Wiring: data to 2, clock to 3; of an ADS1232 PDWN to 4, GAIN0 and GAIN1 high (128), SPEED high (80 a second).

#ifndef IS_ADS1232
#define IS_ADS1232 0
#endif

const uint8_t DATA = 2, CLOCK = 3, POWER = 4;

void setup() {
  Serial.begin(115200);
  Serial.println(F("softcal load cell 1"));
  pinMode(DATA, INPUT);
  pinMode(CLOCK, OUTPUT);
#if IS_ADS1232
  // Its data sheet asks for a low of 26 us once the supplies stand.
  pinMode(POWER, OUTPUT);
  digitalWrite(POWER, LOW);
  delayMicroseconds(50);
  digitalWrite(POWER, HIGH);
#endif
}

static uint8_t clock_bit() {
  // An HX711 whose clock is high for 60 us powers down: no interrupt may come between.
  noInterrupts();
  digitalWrite(CLOCK, HIGH);
  delayMicroseconds(1);
  const uint8_t bit = digitalRead(DATA);
  digitalWrite(CLOCK, LOW);
  interrupts();
  delayMicroseconds(1);
  return bit;
}

void loop() {
  if (digitalRead(DATA)) return;
  const uint32_t ready_ms = millis();
  uint32_t bits = 0;
  for (uint8_t k = 0; k < 24; k++) bits = bits << 1 | clock_bit();
  // The 25th sets gain 128 of an HX711, and takes the data line of an ADS1232 up until the next conversion.
  clock_bit();
  const int32_t counts = (int32_t)(bits << 8) >> 8;

  char line[28];
  char *end = line + strlen(ultoa(ready_ms, line, 10));
  *end++ = ',';
  end += strlen(ltoa(counts, end, 10));
  uint8_t checksum = 0;
  for (const char *byte = line; byte < end; byte++) checksum ^= *byte;
  *end++ = '*';
  *end++ = "0123456789ABCDEF"[checksum >> 4];
  *end++ = "0123456789ABCDEF"[checksum & 15];
  *end = 0;
  Serial.println(line);
}

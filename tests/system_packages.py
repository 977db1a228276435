"""What some tests need beside Python, and the Debian package that brings it."""

PACKAGES = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi",
    "avr-gcc": "gcc-avr avr-libc",
    "chromium": "chromium",
    "g++": "g++",
    "gcc": "gcc",
    "mosquitto": "mosquitto",
    "objcopy": "binutils",
    "openssl": "openssl",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-system-riscv32": "qemu-system-misc",
    "riscv64-unknown-elf-gcc": "gcc-riscv64-unknown-elf",
    "simavr": "simavr",
    "systemd-analyze": "systemd",
}
"""The Debian packages of programs that no wheel brings and that some tests call; `.ci/run` installs them."""

ARDUINO = "gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev"
"""The Debian packages of an Arduino that runs here: its core, its compiler, its simulator."""

NO_POSTGRESQL = "no PostgreSQL answers at SOFTCAL_TEST_POSTGRESQL or 127.0.0.1:5432; apt-get install postgresql"

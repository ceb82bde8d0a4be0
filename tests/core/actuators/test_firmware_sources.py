"""What the firmware's sources promise: C99 without allocation or floating point, and a main file that compiles."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from firmware_host import FIRMWARE, STRICT

CORE = sorted(FIRMWARE.glob("hnf_*.[ch]"))
MAKES = FIRMWARE / "pico" / "CMakeLists.txt"

PICO_SDK = {
    "pico/stdlib.h": "unsigned time_us_32(void);",
    "pico/stdio_usb.h": "bool stdio_usb_init(void); bool stdio_usb_connected(void); extern stdio_driver_t stdio_usb;",
    "pico/stdio/driver.h": """typedef struct {
        void (*out_chars)(const char *buf, int len); void (*out_flush)(void); int (*in_chars)(char *buf, int len);
    } stdio_driver_t;""",
    "hardware/clocks.h": "enum clock_index { clk_sys = 5 }; uint32_t clock_get_hz(enum clock_index);",
    "hardware/gpio.h": """enum { GPIO_OUT = 1, GPIO_FUNC_PWM = 4 };
        void gpio_init(unsigned); void gpio_set_dir(unsigned, bool); void gpio_put(unsigned, bool);
        void gpio_set_function(unsigned, int);""",
    "hardware/irq.h": """enum { PWM_IRQ_WRAP = 4, PICO_HIGHEST_IRQ_PRIORITY = 0 }; typedef void (*irq_handler_t)(void);
        void irq_set_exclusive_handler(unsigned, irq_handler_t); void irq_set_priority(unsigned, uint8_t);
        void irq_set_enabled(unsigned, bool);""",
    "hardware/pwm.h": """typedef struct { uint32_t csr, div, top; } pwm_config; pwm_config pwm_get_default_config(void);
        void pwm_config_set_wrap(pwm_config *, uint16_t); void pwm_init(unsigned, pwm_config *, bool);
        void pwm_set_wrap(unsigned, uint16_t); void pwm_set_counter(unsigned, uint16_t);
        void pwm_set_clkdiv_int_frac(unsigned, uint8_t, uint8_t); void pwm_set_enabled(unsigned, bool);
        void pwm_set_both_levels(unsigned, uint16_t, uint16_t); void pwm_clear_irq(unsigned);
        void pwm_set_irq_enabled(unsigned, bool);""",
    "hardware/watchdog.h": "void watchdog_enable(uint32_t, bool); void watchdog_update(void);",
}
"""What pico/main.c uses of the pico-sdk, copied by hand from its headers."""


def compiler(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"there is no {name} here")
    return found


@pytest.mark.parametrize("path", CORE, ids=lambda path: path.name)
def test_the_core_allocates_nothing_and_has_no_floats(path: Path) -> None:
    code = re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert not re.findall(r"\b(?:float|double|malloc|calloc|realloc|free\()|\d\.\d", code)
    assert set(re.findall(r'#include [<"](\S+)[>"]', code)) <= {
        "stddef.h",
        "stdint.h",
        "string.h",
        "hnf_protocol.h",
        "hnf_device.h",
    }


def test_the_main_file_of_the_pico_is_c_that_compiles(tmp_path: Path) -> None:
    """Its calls fit their declarations; that it works on a board is not shown by it."""
    for name, text in PICO_SDK.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#pragma once\n#include <stdbool.h>\n#include <stdint.h>\n{text}\n", encoding="utf-8")
    definitions = re.findall(r"^  (\w+=\w+)", MAKES.read_text(encoding="utf-8"), re.MULTILINE)
    assert "HNF_CHANNELS=2" in definitions
    for source in ("pico/main.c", "hnf_device.c", "hnf_tick.c", "hnf_protocol.c"):
        order = [compiler("cc"), *STRICT, "-fsyntax-only", f"-I{tmp_path}", *(f"-D{each}" for each in definitions)]
        done = subprocess.run([*order, str(FIRMWARE / source)], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr


def test_the_pico_has_memory_for_the_rates_that_it_offers() -> None:
    """15 ms of all channels at its highest rate."""
    main = (FIRMWARE / "pico" / "main.c").read_text(encoding="utf-8")
    highest = int(re.findall(r"1000, (\d+), 32767", main)[0])
    memory = int(re.findall(r"HNF_QUEUE_SAMPLES=(\d+)u", MAKES.read_text(encoding="utf-8"))[0])
    assert memory == 2 * highest * 15 // 1000


def test_the_core_compiles_for_the_microcontroller(tmp_path: Path) -> None:
    for source in ("hnf_device.c", "hnf_tick.c", "hnf_protocol.c"):
        order = [compiler("arm-none-eabi-gcc"), "-mcpu=cortex-m0plus", "-mthumb", *STRICT, "-Os", "-c"]
        done = subprocess.run(
            [*order, str(FIRMWARE / source), "-o", str(tmp_path / "core.o")], capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stderr

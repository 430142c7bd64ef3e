#!/usr/bin/env python3
"""Makes registers.txt from ST's SVD of the STM32G474: one line a peripheral, register or field.

    python3 make_registers.py STM32G474.svd > registers.txt

The SVD (version 2.9, Apache-2.0, (c) STMicroelectronics) comes with ST's tools and from
github.com/modm-io/cmsis-svd-stm32, folder stm32g4. Three megabytes of prose become what the emulated
board needs: addresses, reset values, which bits exist.

    P name base                peripheral
    R name offset reset        register, numbers in hexadecimal
    F name bit width access    field, bit and width in decimal
"""
import re
import sys
import xml.etree.ElementTree as ET


# What the firmware touches; anything else that it would touch is reported by the emulator.
WANTED = ("FLASH RCC PWR GPIOA GPIOB GPIOC EXTI SYSCFG COMP DAC1 ADC1 ADC2 ADC3 ADC12_Common ADC345_Common DMA1 DMAMUX "
          "HRTIM_Master HRTIM_TIMA HRTIM_TIMB HRTIM_Common LPUART1 USB_FS_device IWDG CRS DBGMCU CRC TIM2 TIM16 ADC4 RNG").split()


def number(text):
    return int(text, 0)


def main():
    root = ET.parse(sys.argv[1]).getroot()
    peripherals = {p.find("name").text: p for p in root.find("peripherals")}
    for name in sorted(WANTED):
        p = peripherals[name]
        source = peripherals[p.get("derivedFrom")] if p.get("derivedFrom") else p
        print(f"P {name} {number(p.find('baseAddress').text):x}")
        for r in sorted(source.find("registers"), key=lambda r: number(r.find("addressOffset").text)):
            reset = r.find("resetValue")
            print(f"R {r.find('name').text} {number(r.find('addressOffset').text):x} "
                  f"{number(reset.text) if reset is not None else 0:x}")
            fields = r.find("fields")
            for f in sorted(fields if fields is not None else [], key=lambda f: int(f.find("bitOffset").text)):
                access = f.find("access")
                access = access.text if access is not None else "read-write"
                print(f"F {re.sub(r'[^A-Za-z0-9_]', '_', f.find('name').text)} {f.find('bitOffset').text} "
                      f"{f.find('bitWidth').text} {access}")


main()

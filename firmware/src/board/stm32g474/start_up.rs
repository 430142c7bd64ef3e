//! Before `main`: all RAM is written once, code and constants go to where there are no wait states.

use core::arch::global_asm;

// cortex-m-rt calls this before it fills .data and .bss, with the stack pointer set and nothing else.
//
// 1. RAM parity (option bit SRAM_PE): parity bits are undefined at power-on, and a word must be written
//    before it is read, or NMI comes (RM0440, section 2.4.1). So zero all but the crash record, which
//    is in SRAM2, where there are none. 6 ms of HSI16.
// 2. The sampling path and all constants into the CCM SRAM (firmware/ccm.x).
// 3. The vectors too, and VTOR (Armv7-M, B3.2.5): the processor fetches a vector while it pushes
//    registers over another bus.
//
// Assembly, as Rust code may use what is not there yet. No stack: it is among what is cleared.
global_asm!(
    ".section .text.__pre_init, \"ax\"",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".thumb_func",
    "__pre_init:",
    "movs r2, #0",
    "movs r3, #0",
    // SRAM1 and SRAM2, up to the crash record.
    "ldr r0, =0x20000000",
    "ldr r1, =__crash_record",
    "1: stmia r0!, {{r2, r3}}",
    "cmp r0, r1",
    "blo 1b",
    // The CCM SRAM.
    "ldr r0, =0x10000000",
    "ldr r1, =0x10008000",
    "2: stmia r0!, {{r2, r3}}",
    "cmp r0, r1",
    "blo 2b",
    // .ccm
    "ldr r0, =__sccm",
    "ldr r1, =__eccm",
    "ldr r2, =__siccm",
    "b 4f",
    "3: ldmia r2!, {{r3}}",
    "stmia r0!, {{r3}}",
    "4: cmp r0, r1",
    "blo 3b",
    // The vectors, which lie in front of .text.
    "ldr r0, =__ccm_vectors",
    "ldr r1, =__vector_table",
    "ldr r2, =__stext",
    "b 6f",
    "5: ldmia r1!, {{r3}}",
    "stmia r0!, {{r3}}",
    "6: cmp r1, r2",
    "blo 5b",
    // SCB_VTOR
    "ldr r0, =0xE000ED08",
    "ldr r1, =__ccm_vectors",
    "str r1, [r0]",
    "dsb",
    "isb",
    "bx lr",
    ".ltorg",
    ".size __pre_init, . - __pre_init",
);

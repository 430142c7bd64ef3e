use super::*;

fn open() -> Flash {
    let mut flash = Flash::default();
    for key in KEYS {
        flash.set_register(KEYR, key).unwrap();
    }
    flash
}

fn status(flash: &Flash) -> u32 {
    flash.register(SR) & sr::ERRORS
}

#[test]
fn without_its_keys_nothing_changes() {
    let mut flash = Flash::default();
    flash.bytes[0] = 0;
    flash.set_register(CR, cr::PER | cr::STRT).unwrap();
    assert_eq!(flash.bytes[0], 0);
    flash.set_register(KEYR, KEYS[1]).unwrap_err();
    // Jammed until a reset.
    flash.set_register(KEYR, KEYS[0]).unwrap_err();
    flash.reset();
    for key in KEYS {
        flash.set_register(KEYR, key).unwrap();
    }
    flash.set_register(CR, cr::PER | cr::STRT).unwrap();
    assert_eq!(flash.bytes[0], 0xFF);
}

#[test]
fn a_page_of_the_second_bank_is_erased_alone() {
    let mut flash = open();
    flash.bytes.fill(0);
    let page = cr::PER | cr::BKER | 3 << cr::PNB;
    flash.set_register(CR, page | cr::STRT).unwrap();
    let erased = |at: usize| flash.bytes[at] == 0xFF;
    let begins = 131 * 2_048;
    assert!(erased(begins) && erased(begins + 2_047));
    assert!(!erased(begins - 1) && !erased(begins + 2_048));
}

#[test]
fn what_is_not_erased_takes_zeros_alone() {
    let mut flash = open();
    flash.set_register(CR, cr::PG).unwrap();
    flash.program(FLASH_ADDRESS, [1; 8]);
    assert_eq!(status(&flash), 0);
    flash.program(FLASH_ADDRESS, [2; 8]);
    assert_eq!(status(&flash), sr::PROGERR);
    // An error stands until it is cleared.
    flash.program(FLASH_ADDRESS + 8, [2; 8]);
    assert_eq!(status(&flash), sr::PROGERR | sr::PGSERR);
    flash.set_register(SR, sr::ERRORS).unwrap();
    flash.program(FLASH_ADDRESS, [0; 8]);
    assert_eq!((status(&flash), flash.bytes[0]), (0, 0));
}

#[test]
fn a_protected_page_stays() {
    let mut flash = open().with_options(
        0xFFEF_F8AA,
        [0xFF01_FF01, 0xFF00_FFFF, 0xFF00_FFFF, 0xFF00_FFFF],
    );
    flash.bytes.fill(0);
    flash
        .set_register(CR, cr::PER | 1 << cr::PNB | cr::STRT)
        .unwrap();
    assert_eq!((status(&flash), flash.bytes[2_048]), (sr::WRPERR, 0));
}

#[test]
fn option_bytes_act_when_they_are_loaded() {
    let mut flash = open();
    flash.set_register(OPTR, 0xFEEF_F8AA).unwrap();
    for key in OPTION_KEYS {
        flash.set_register(OPTKEYR, key).unwrap();
    }
    flash.set_register(OPTR, 0xFEEF_F9AA).unwrap();
    flash.set_register(CR, cr::OPTSTRT).unwrap();
    assert_eq!(flash.register(OPTR), 0xFEEF_FCAA);
    flash.set_register(CR, cr::OBL_LAUNCH).unwrap();
    assert!(flash.wants_reset() && !flash.wants_reset());
    flash.reset();
    assert_eq!(flash.register(OPTR), 0xFEEF_F9AA);
}

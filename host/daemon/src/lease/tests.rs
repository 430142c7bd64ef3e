use super::*;

#[test]
fn one_name_holds_it_until_it_runs_out() {
    let mut book = LeaseBook::default();
    let t0 = Instant::now();
    let at = |s: u64| t0 + Duration::from_secs(s);
    assert_eq!(book.take("a", false, t0), Ok(LeaseGrant::New));
    let other = book.take("b", false, at(3)).unwrap_err();
    assert_eq!((other.holder.as_str(), other.expires_in_s), ("a", 7));
    assert_eq!(book.take("a", false, at(8)), Ok(LeaseGrant::Renewed));
    assert_eq!(book.expired(at(17)), None);
    assert_eq!(book.expired(at(18)), Some("a".to_owned()));
    assert_eq!(book.expired(at(18)), None);
    assert_eq!(book.take("b", false, at(18)), Ok(LeaseGrant::New));
}

#[test]
fn power_that_the_device_has_not_ends_the_lease() {
    let now = Instant::now();
    // Power that the device reports, panel present, lease ends, power left to switch off.
    for (asked_w, has_panel, ends, left_w) in [
        (900, false, false, 900),
        (900, true, false, 900),
        (500, true, false, 900),
        (0, false, true, 0),
        (0, true, true, 0),
        // Another host's request.
        (500, false, true, 900),
        (2_000, false, true, 900),
        // A panel only lowers it.
        (2_000, true, true, 900),
    ] {
        let mut book = LeaseBook::default();
        let (id, _) = book.begin_command("a", now).unwrap();
        assert_eq!(
            book.check_device_power(asked_w, has_panel),
            None,
            "it asks for nothing"
        );
        book.request_power(id, 900, now).unwrap();
        let lost = book.check_device_power(asked_w, has_panel);
        let expected = ends.then(|| LostLease {
            holder: "a".to_owned(),
            power_w: 900,
        });
        assert_eq!(lost, expected, "{asked_w} {has_panel}");
        assert_eq!(book.asked_w(), left_w, "{asked_w} {has_panel}");
        assert_eq!(book.must_switch_off(now), ends && left_w > 0);
        assert_eq!(book.current(now).is_none(), ends);
    }
}

#[test]
fn a_lease_ends_with_its_last_command_unless_it_was_taken() {
    let now = Instant::now();
    let mut book = LeaseBook::default();
    let (first, _) = book.begin_command("a", now).unwrap();
    let (second, _) = book.begin_command("a", now).unwrap();
    assert!(!book.heats(now), "no power was requested");
    assert!(!book.end_command(first) && book.current(now).is_some());
    assert!(book.end_command(second) && book.current(now).is_none());
    // A command of the ended grant does not end the next one.
    let (later, _) = book.begin_command("b", now).unwrap();
    assert!(!book.end_command(second) && book.current(now).is_some());
    book.take("b", false, now).unwrap();
    assert!(!book.end_command(later) && book.current(now).is_some());
}

#[test]
fn force_takes_it_from_somebody_by_name() {
    let mut book = LeaseBook::default();
    let now = Instant::now();
    book.take("a", false, now).unwrap();
    assert_eq!(
        book.take("b", true, now),
        Ok(LeaseGrant::From("a".to_owned()))
    );
    assert!(!book.release("a"), "it is not theirs any more");
    assert!(book.release("b"));
    assert_eq!(book.current(now), None);
}

#[test]
fn a_lease_that_ran_out_is_nobodys_before_anybody_has_noticed() {
    let mut book = LeaseBook::default();
    let now = Instant::now();
    book.take("a", false, now).unwrap();
    let later = now + Duration::from_secs(LEASE_S);
    assert_eq!(book.current(later), None);
    assert_eq!(book.take("b", false, later), Ok(LeaseGrant::New));
}

/// Every order of two commands' beginnings, executions and ends, of one holder and of two: a device that was asked for power has
/// a living lease or is to be switched off.
#[test]
fn no_order_of_two_commands_leaves_power_without_a_lease() {
    // Each command begins (0), is executed (1), ends (2); `heats` asks for power when executed.
    let orders = [
        [0, 0, 0, 1, 1, 1],
        [0, 0, 1, 0, 1, 1],
        [0, 0, 1, 1, 0, 1],
        [0, 0, 1, 1, 1, 0],
        [0, 1, 0, 0, 1, 1],
        [0, 1, 0, 1, 0, 1],
        [0, 1, 0, 1, 1, 0],
        [0, 1, 1, 0, 0, 1],
        [0, 1, 1, 0, 1, 0],
        [0, 1, 1, 1, 0, 0],
    ];
    let mut heated = 0;
    for order in orders {
        for case in 0..16 {
            let heats = [case & 1 > 0, case & 2 > 0];
            let holders = ["a", if case & 4 > 0 { "b" } else { "a" }];
            let refused = case & 8 > 0;
            let mut book = LeaseBook::default();
            let now = Instant::now();
            let (mut step, mut ids) = ([0; 2], [None; 2]);
            for which in order {
                let id: Option<LeaseId> = ids[which];
                match (step[which], id) {
                    (0, _) => {
                        let begun = book.begin_command(holders[which], now);
                        ids[which] = begun.ok().map(|(id, _)| id);
                    }
                    (1, Some(id)) if heats[which] => {
                        let before = book.request_power(id, 1_000, now).unwrap();
                        if refused && which == 0 {
                            book.request_power(id, before, now).unwrap();
                        }
                    }
                    (2, Some(id)) => drop(book.end_command(id)),
                    _ => {}
                }
                step[which] += 1;
                let living = book.current(now).is_some();
                assert!(book.asked_w() == 0 || living, "{order:?} {case}: {book:?}");
                assert!(!book.must_switch_off(now), "{order:?} {case}: {book:?}");
            }
            heated += u32::from(book.asked_w() > 0);
        }
    }
    assert!(heated > 40, "{heated}");
}

#[test]
fn what_was_asked_for_before_an_off_heats_no_more_and_what_is_asked_for_later_does() {
    let now = Instant::now();
    let mut book = LeaseBook::default();
    let (heating, _) = book.begin_command("a", now).unwrap();
    assert_eq!(book.request_power(heating, 700, now), Ok(0));
    let (waiting, _) = book.begin_command("a", now).unwrap();
    book.off();
    assert!(book.must_switch_off(now) && !book.heats(now));
    for id in [heating, waiting] {
        assert_eq!(book.request_power(id, 900, now), Err(LeaseError::Off));
        assert_eq!(book.keep_after_command(id, now), Err(LeaseError::Off));
        assert_eq!(book.check_heating(id, now), Err(LeaseError::Off));
        assert_eq!(
            book.check(id, now),
            Ok(()),
            "what heats nothing may be done"
        );
    }
    assert_eq!(book.asked_w(), 700);
    book.confirm_off();
    assert_eq!((book.asked_w(), book.must_switch_off(now)), (0, false));
    let lease = book.current(now).unwrap();
    assert_eq!(lease.holder, "a", "the lease is not what ended");
    let (later, _) = book.begin_command("a", now).unwrap();
    assert_eq!(book.request_power(later, 900, now), Ok(0));
    assert!(book.heats(now));
    assert!(!book.end_command(waiting) && !book.end_command(later));
}

/// Nothing was requested under a lease: the power is a panel's or another host's.
#[test]
fn power_of_whomever_has_to_end_until_an_off_is_confirmed() {
    let now = Instant::now();
    let mut book = LeaseBook::default();
    book.off();
    assert!(!book.must_switch_off(now));
    book.require_off();
    assert!(book.must_switch_off(now) && !book.heats(now));
    assert_eq!(book.asked_w(), 0);
    book.take("a", false, now).unwrap();
    assert!(book.is_off_due() && book.must_switch_off(now));
    book.confirm_off();
    assert!(!book.is_off_due() && !book.must_switch_off(now));
}

#[test]
fn power_of_a_lease_that_is_over_has_to_end_and_none_can_be_asked_for_under_it() {
    let now = Instant::now();
    let late = now + Duration::from_secs(LEASE_S);
    for end in 0..5 {
        let mut book = LeaseBook::default();
        let (id, _) = book.begin_command("a", now).unwrap();
        assert_eq!(book.request_power(id, 700, now), Ok(0));
        assert!(!book.end_command(id), "it heats");
        assert!(book.heats(now));
        let now = match end {
            0 => book.release("a").then_some(now),
            1 => book.expired(late).map(|_| late),
            2 => book.revoke().map(|_| now),
            3 => book.take("b", true, now).ok().map(|_| now),
            // Not polled since.
            _ => Some(late),
        };
        let now = now.expect("it has ended");
        assert!(
            book.must_switch_off(now) && !book.heats(now),
            "{end}: {book:?}"
        );
        assert_eq!(book.request_power(id, 900, now), Err(LeaseError::Ended));
        assert_eq!(book.check(id, now), Err(LeaseError::Ended));
        assert_eq!(book.asked_w(), 700);
        book.confirm_off();
        assert!(!book.must_switch_off(now));
        assert_eq!(book.asked_w(), 0);
    }
}

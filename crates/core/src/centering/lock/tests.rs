//! The state machine, with all kinds of observations.

use super::*;

const LIMITS: LockLimits = LockLimits { offset: 3e-6, lock_s: 0.05, lost_s: 0.05, search: true, attempts: 2 };
const DT: f64 = 1e-3;
const COVERED_ONE: LockInput =
    LockInput::Partial { elsewhere: false, covered: true, news: false, cause: LockCause::LittleLight };
const ELSEWHERE: LockInput =
    LockInput::Partial { elsewhere: true, covered: false, news: false, cause: LockCause::LittleLight };
const HERE: LockInput =
    LockInput::Partial { elsewhere: false, covered: false, news: false, cause: LockCause::LittleLight };

fn new() -> Lock {
    Lock::new(LIMITS, LoopMode::On)
}

fn feed(lock: &mut Lock, seen: LockInput, n: usize) -> LockState {
    for _ in 0..n {
        let _ = lock.update(seen, false, DT);
    }
    lock.state()
}

fn off_by(size: f64) -> LockInput {
    LockInput::Error { size, railed: false }
}

/// Actions and states, one after the other, while the observation stays the same for `n` samples.
fn course(lock: &mut Lock, seen: LockInput, n: usize) -> Vec<(Action, LockState)> {
    let mut course: Vec<_> = (0..n).map(|_| (lock.update(seen, false, DT).action, lock.state())).collect();
    course.dedup();
    course
}

#[test]
fn locked_only_after_the_confirmation_time_within_limits() {
    let mut lock = new();
    assert_eq!(feed(&mut lock, off_by(1e-6), 48), LockState::Acquiring);
    assert_eq!(feed(&mut lock, off_by(1e-6), 3), LockState::Locked);
    assert_eq!(feed(&mut lock, off_by(4e-6), 1), LockState::Acquiring);
    assert_eq!(feed(&mut lock, off_by(f64::NAN), 1000), LockState::Acquiring);
}

#[test]
fn with_a_large_rms_there_is_no_lock_even_with_small_samples_in_between() {
    let mut lock = new();
    feed(&mut lock, off_by(100e-6), 10);
    assert_eq!(feed(&mut lock, off_by(1e-6), 60), LockState::Acquiring);
    assert_eq!(feed(&mut lock, off_by(1e-6), 400), LockState::Locked);
}

#[test]
fn railed_is_not_locked() {
    let mut lock = new();
    feed(&mut lock, off_by(0.0), 60);
    let railed = LockInput::Error { size: 0.0, railed: true };
    assert_eq!(feed(&mut lock, railed, 1), LockState::Railed);
    assert_eq!(feed(&mut lock, off_by(0.0), 9), LockState::Railed, "no flicker");
    assert_eq!(feed(&mut lock, off_by(0.0), 2), LockState::Acquiring);
}

#[test]
fn a_search_stops_when_it_is_no_longer_allowed() {
    let mut lock = new();
    feed(&mut lock, LockInput::Dark, 150);
    assert_eq!(lock.state(), LockState::Searching);
    lock.retune(LockLimits { search: false, ..LIMITS });
    assert_eq!(course(&mut lock, LockInput::Dark, 1000), [(Action::Holding, LockState::Lost)]);
}

#[test]
fn a_beam_that_is_found_and_lost_repeatedly_is_abandoned() {
    let mut lock = new();
    let mut found = 0;
    while lock.state() != LockState::Held || found < 5 {
        feed(&mut lock, LockInput::Dark, 150);
        found += u32::from(lock.update(off_by(100e-6), false, DT).action == Action::Regulating);
        assert!(found < 100);
    }
    for seen in [off_by(0.0), LockInput::Dark, ELSEWHERE] {
        assert_eq!(course(&mut lock, seen, 1000), [(Action::Waiting, LockState::Held)]);
    }
    assert!(found == MOST_SLIPS, "{found}");
    assert!(lock.search());
    assert_eq!(feed(&mut lock, off_by(0.0), 200), LockState::Locked);
}

#[test]
fn a_loss_is_confirmed_twice_before_the_search() {
    let mut lock = new();
    feed(&mut lock, off_by(0.0), 60);
    let expected = [
        (Action::Holding, LockState::Held),
        (Action::Holding, LockState::Lost),
        (Action::Searching, LockState::Searching),
    ];
    assert_eq!(course(&mut lock, LockInput::Dark, 49), expected[..1]);
    assert_eq!(course(&mut lock, LockInput::Dark, 50), expected[1..2]);
    assert_eq!(course(&mut lock, LockInput::Dark, 1), expected[2..]);
    assert_eq!(feed(&mut lock, off_by(0.0), 10), LockState::Acquiring, "light ends the search");
}

#[test]
fn an_unclear_state_is_held_and_never_searched() {
    let mut lock = new();
    let held = [(Action::Holding, LockState::Held), (Action::Holding, LockState::Lost)];
    assert_eq!(course(&mut lock, LockInput::Unclear(LockCause::Clipped), 10_000), held);
    let mut forbidden = Lock::new(LockLimits { search: false, ..LIMITS }, LoopMode::On);
    for seen in [LockInput::Dark, ELSEWHERE, HERE] {
        feed(&mut forbidden, off_by(0.0), 60);
        assert_eq!(course(&mut forbidden, seen, 10_000), held);
    }
}

#[test]
fn with_some_light_the_loop_jumps_after_one_confirmation_and_then_searches() {
    let mut lock = new();
    feed(&mut lock, off_by(0.0), 60);
    assert_eq!(feed(&mut lock, ELSEWHERE, 49), LockState::Held);
    let mut jumps = 0;
    while lock.state() != LockState::Searching {
        let decision = lock.update(ELSEWHERE, true, DT);
        jumps += u32::from(decision.action == Action::Jumping && decision.begins);
    }
    assert_eq!(jumps, MOST_JUMPS);
    // Where the stage arrives and the apex is not, a search begins at once.
    let mut lock = new();
    feed(&mut lock, ELSEWHERE, 60);
    assert_eq!(lock.update(HERE, false, DT).action, Action::Jumping);
    assert_eq!(lock.update(HERE, true, DT).action, Action::Searching);
}

#[test]
fn a_covered_psd_is_held_longer() {
    let mut lock = new();
    feed(&mut lock, off_by(0.0), 60);
    assert_eq!(feed(&mut lock, COVERED_ONE, 990), LockState::Lost);
    assert_eq!(feed(&mut lock, COVERED_ONE, 20), LockState::Searching);
    assert_eq!(feed(&mut lock, HERE, 1000), LockState::Searching);
}

#[test]
fn after_the_limit_of_failed_searches_the_loop_waits_for_light_or_a_command() {
    let mut lock = new();
    let searched = |lock: &mut Lock| {
        feed(lock, LockInput::Dark, 110);
        let mut starts = 1;
        while lock.state() == LockState::Searching {
            starts += u32::from(lock.update(LockInput::Dark, true, DT).begins);
        }
        starts
    };
    assert_eq!(searched(&mut lock), 2);
    assert_eq!(course(&mut lock, LockInput::Dark, 10_000), [(Action::Waiting, LockState::Held)]);
    assert!(lock.search());
    assert_eq!(searched(&mut lock), 2, "a person");
    assert_eq!(course(&mut lock, ELSEWHERE, 1000), [(Action::Waiting, LockState::Held)], "no news");
    let news =
        LockInput::Partial { elsewhere: true, covered: false, news: true, cause: LockCause::LittleLight };
    assert_eq!(lock.update(news, false, DT).action, Action::Jumping);
    feed(&mut lock, off_by(0.0), 60);
    assert_eq!((lock.state(), lock.attempts()), (LockState::Locked, 0));
}

#[test]
fn off_and_manual_stay_until_they_are_switched() {
    for (mode, state) in [(LoopMode::Off, LockState::Off), (LoopMode::Manual, LockState::Manual)] {
        let mut lock = Lock::new(LIMITS, mode);
        for seen in [off_by(0.0), LockInput::Dark, ELSEWHERE] {
            assert_eq!(course(&mut lock, seen, 1000), [(Action::Holding, state)]);
        }
        assert_eq!(lock.switch(LoopMode::On).unwrap().to, LockState::Acquiring);
        assert_eq!(feed(&mut lock, off_by(0.0), 60), LockState::Locked);
        lock.retune(LockLimits { offset: 1e-6, ..LIMITS });
        assert_eq!(feed(&mut lock, off_by(2e-6), 1), LockState::Acquiring, "the new limit counts");
        assert_eq!(lock.switch(mode).unwrap().to, state);
    }
}

#[test]
fn giving_up_is_a_change_with_a_cause_that_remains() {
    let mut lock = new();
    let mut changes = Vec::new();
    for _ in 0..MOST_SLIPS {
        feed(&mut lock, ELSEWHERE, 60); // lost, then a jump
        feed(&mut lock, off_by(10e-6), 3);
        changes.extend(lock.update(LockInput::Unclear(LockCause::Clipped), false, DT).transition);
    }
    let last = lock.update(LockInput::Dark, false, DT);
    assert_eq!((last.action, last.transition), (Action::Waiting, None), "reported once");
    let held = |cause| Transition { from: LockState::Acquiring, to: LockState::Held, cause };
    assert_eq!(changes.last(), Some(&held(LockCause::LostTooOften)));
    assert_eq!(lock.cause(), LockCause::LostTooOften);
}

#[test]
fn the_cause_follows_the_observation_while_the_state_remains() {
    let mut lock = new();
    feed(&mut lock, LockInput::Unclear(LockCause::Clipped), 1);
    let held = lock.update(LockInput::Dark, false, DT);
    assert_eq!((held.transition, lock.state(), lock.cause()), (None, LockState::Held, LockCause::NoLight));
    feed(&mut lock, off_by(10e-6), 1);
    assert_eq!((lock.state(), lock.cause()), (LockState::Acquiring, LockCause::OffsetTooLarge));
    let _ = lock.switch(LoopMode::Manual);
    assert_eq!((lock.state(), lock.cause()), (LockState::Manual, LockCause::SwitchedToManual));
}

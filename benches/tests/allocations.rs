//! The allocations of a running daemon's threads while clients connect and disconnect.
#![allow(
    unsafe_code,
    reason = "an allocator is unsafe by its trait, and so is setting a variable of the environment"
)]
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord::commands::run;
use motord_client::{Claim, Client, Error, RUNTIME_DIR_VARIABLE, Setpoint};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::time::Duration;

/// Twelve motors on four simulated buses at 1 kHz, with timeouts for machines that stall.
const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/quadruped-simulated.toml");
const INSTANCE: &str = "demo";
const GROUP: &str = "legs";
const CYCLES: u64 = 10_000;
/// Cycles in which one client watches and none connects.
const QUIET_CYCLES: u64 = 4_000;
const TIMEOUT: Duration = Duration::from_secs(5);
/// Limit on the allocations of the ipc thread in a cycle without requests.
const IPC_MAX: f64 = 0.05;
/// Limit on the allocations of the telemetry thread in a second: iceoryx2 needs thousands in each
/// cleanup after dead clients.
const TELEMETRY_MAX: f64 = 10_000.0;
/// The watched threads.
const THREADS: [&str; 3] = ["motord-cycle", "motord-ipc", "motord-telemetr"];

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The watched threads by id; 0 for none.
static WATCHED: [AtomicI32; 3] = [const { AtomicI32::new(0) }; 3];
static ALLOCATIONS: [AtomicU64; 3] = [const { AtomicU64::new(0) }; 3];
static FREES: [AtomicU64; 3] = [const { AtomicU64::new(0) }; 3];

thread_local! {
    /// The kernel's id of this thread; 0 until it is read.
    static THREAD: Cell<i32> = const { Cell::new(0) };
}

impl Counting {
    fn count(counters: &[AtomicU64; 3]) {
        if WATCHED.iter().all(|watched| watched.load(Ordering::Relaxed) == 0) {
            return;
        }
        if THREAD.get() == 0 {
            THREAD.set(nix::unistd::gettid().as_raw());
        }
        for (watched, counter) in WATCHED.iter().zip(counters) {
            if watched.load(Ordering::Relaxed) == THREAD.get() {
                counter.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

// SAFETY: every call passes its arguments to `System`; counting neither allocates nor unwinds. The
// provided methods call these two.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::count(&ALLOCATIONS);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        Self::count(&FREES);
        // SAFETY: `pointer` came from `System` with this layout, as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Returns the allocations and the frees of each of `threads` during `run`.
fn calls_of(threads: [i32; 3], run: impl FnOnce()) -> [(u64, u64); 3] {
    let take = |counter: &AtomicU64| counter.swap(0, Ordering::Relaxed);
    let set = |threads: [i32; 3]| {
        WATCHED.iter().zip(threads).for_each(|(watched, thread)| watched.store(thread, Ordering::Relaxed));
    };
    set(threads);
    run();
    set([0; 3]);
    [0, 1, 2].map(|index| (take(&ALLOCATIONS[index]), take(&FREES[index])))
}

/// Returns the id of this process's thread `name`.
fn thread(name: &str) -> i32 {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().map(|task| task.unwrap());
    let named = |task: &std::fs::DirEntry| {
        std::fs::read_to_string(task.path().join("comm")).is_ok_and(|comm| comm.trim() == name)
    };
    let found: Vec<_> = tasks.filter(named).map(|task| task.file_name()).collect();
    assert_eq!(found.len(), 1, "threads called {name}");
    found[0].to_str().unwrap().parse().unwrap()
}

/// Connects as soon as the daemon is ready.
fn connect() -> Client {
    let begun = std::time::Instant::now();
    loop {
        match Client::connect(INSTANCE) {
            Ok(client) => return client,
            Err(error) => assert!(begun.elapsed() < TIMEOUT, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Returns after this many cycles; missed ticks do not count.
fn await_cycles(client: &Client, count: u64) {
    let run = || client.wait(TIMEOUT).map(|state| state.cycle() - state.overruns()).unwrap();
    let first = run();
    while run() < first + count {}
}

/// Runs one client: it claims the robot if it is free, moves it, and ends in one of several ways.
fn live(life: u64) -> Result<(), Error> {
    let client = Client::connect(INSTANCE)?;
    client.wait(TIMEOUT)?;
    client.reset(GROUP)?;
    let mut claim = client.claim(GROUP)?;
    follow(&client, &mut claim, 20)?;
    claim.enable()?;
    follow(&client, &mut claim, 300)?;
    match life % 4 {
        0 => claim.disable(),
        1 => claim.release(),
        2 => client.emergency_stop(),
        // Like a killed process: the daemon receives no release, and the operator releases the
        // robot.
        _ => {
            std::mem::forget(claim);
            client.force_release(GROUP)
        }
    }
}

/// Sends setpoints for this many cycles.
fn follow(client: &Client, claim: &mut Claim, cycles: u64) -> Result<(), Error> {
    for cycle in 0..cycles {
        let state = client.wait(TIMEOUT)?;
        let swing = 0.002 * (cycle % 50) as f32;
        let hold = state
            .joints()
            .map(|joint| Setpoint::impedance(joint.position().unwrap() + swing, 0.0, 40.0, 1.0, 0.0));
        claim.send(&hold.collect::<Vec<_>>())?;
    }
    Ok(())
}

/// Runs one client after another until `end`; returns the number of successful ones.
fn run_clients(end: &AtomicBool) -> u64 {
    let mut whole = 0;
    for life in 0.. {
        if end.load(Ordering::Relaxed) {
            break;
        }
        whole += u64::from(live(life).is_ok());
    }
    whole
}

#[test]
fn allocations_of_daemon_threads_are_bounded() {
    let me = nix::unistd::gettid().as_raw();
    let calls = calls_of([me, 0, me], || drop(std::hint::black_box(Box::new(7))));
    assert_eq!(calls, [(1, 1), (0, 0), (1, 1)], "the counters count");

    let runtime = tempfile::tempdir().unwrap();
    // SAFETY: this is the only test of this program, and no other thread reads the environment yet.
    unsafe { std::env::set_var(RUNTIME_DIR_VARIABLE, runtime.path()) };
    let daemon = std::thread::spawn(|| run::run(Path::new(CONFIG), &run::Options::default()));
    let watcher = connect();
    await_cycles(&watcher, 10);

    let threads = THREADS.map(thread);
    let begun = std::time::Instant::now();
    let quiet = calls_of(threads, || await_cycles(&watcher, QUIET_CYCLES));
    let seconds = begun.elapsed().as_secs_f64();

    let end = Arc::new(AtomicBool::new(false));
    let clients = [(); 2].map(|()| {
        std::thread::spawn({
            let end = Arc::clone(&end);
            move || run_clients(&end)
        })
    });
    let busy = calls_of(threads, || await_cycles(&watcher, CYCLES));
    end.store(true, Ordering::Relaxed);
    let whole_lives: u64 = clients.into_iter().map(|client| client.join().unwrap()).sum();

    kill(Pid::this(), Signal::SIGTERM).unwrap();
    daemon.join().unwrap().unwrap();
    assert!(whole_lives >= 4, "only {whole_lives} clients did all they should");
    assert_eq!(quiet[0], (0, 0), "allocations and frees of the cycle thread in {QUIET_CYCLES} cycles");
    assert_eq!(busy[0], (0, 0), "allocations and frees of the cycle thread in {CYCLES} cycles");
    let ipc = quiet[1].0 as f64 / QUIET_CYCLES as f64;
    let telemetry = quiet[2].0 as f64 / seconds;
    println!(
        "allocations: {ipc:.3} of ipc in a cycle, {telemetry:.0} of telemetry in a second; with clients {busy:?}"
    );
    assert!(ipc <= IPC_MAX, "{ipc} allocations of the ipc thread in a cycle");
    assert!(telemetry <= TELEMETRY_MAX, "{telemetry} allocations of the telemetry thread in a second");
}

//! The running cycle thread, watched by the allocator while clients come and go.
#![allow(
    unsafe_code,
    reason = "an allocator is unsafe by its trait, and so is setting a variable of the environment"
)]
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use motord_client::{Claim, Client, Error, RUNTIME_DIR_VARIABLE, Setpoint};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::time::Duration;

/// Twelve motors on four simulated buses at 1 kHz, patient with machines that stall.
const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/quadruped-simulated.toml");
const INSTANCE: &str = "demo";
const GROUP: &str = "legs";
const CYCLES: u64 = 10_000;
const PATIENCE: Duration = Duration::from_secs(5);

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The thread whose calls count; 0 for none.
static WATCHED: AtomicI32 = AtomicI32::new(0);
static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);
static FREES: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// The number the kernel gave this thread; 0 until it is asked for.
    static THREAD: Cell<i32> = const { Cell::new(0) };
}

impl Counting {
    fn count(counter: &AtomicU64) {
        let watched = WATCHED.load(Ordering::Relaxed);
        if watched == 0 {
            return;
        }
        if THREAD.get() == 0 {
            THREAD.set(nix::unistd::gettid().as_raw());
        }
        if THREAD.get() == watched {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }
}

// SAFETY: every call goes to `System` with the arguments it came with; counting neither allocates nor unwinds. The
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

/// Calls of `thread` to the allocator while `run` lasts: allocations and frees.
fn calls_of(thread: i32, run: impl FnOnce()) -> (u64, u64) {
    let count = || (ALLOCATIONS.load(Ordering::Relaxed), FREES.load(Ordering::Relaxed));
    let before = count();
    WATCHED.store(thread, Ordering::Relaxed);
    run();
    WATCHED.store(0, Ordering::Relaxed);
    let after = count();
    (after.0 - before.0, after.1 - before.1)
}

/// The thread of this process that is called `name`.
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
            Err(error) => assert!(begun.elapsed() < PATIENCE, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Returns once this many cycles have run; missed ticks do not count.
fn await_cycles(client: &Client, count: u64) {
    let run = || client.wait(PATIENCE).map(|state| state.cycle() - state.overruns()).unwrap();
    let first = run();
    while run() < first + count {}
}

/// One life of a client: it takes the robot if nobody has it, moves it, and leaves it in one way or another.
fn live(life: u64) -> Result<(), Error> {
    let client = Client::connect(INSTANCE)?;
    client.wait(PATIENCE)?;
    client.reset(GROUP)?;
    let mut claim = client.claim(GROUP)?;
    follow(&client, &mut claim, 20)?;
    claim.enable()?;
    follow(&client, &mut claim, 300)?;
    match life % 4 {
        0 => claim.disable(),
        1 => claim.release(),
        2 => client.emergency_stop(),
        // As a process that dies: the daemon hears nothing, and the operator takes the robot from nobody.
        _ => {
            std::mem::forget(claim);
            client.force_release(GROUP)
        }
    }
}

/// Sends setpoints for this many cycles.
fn follow(client: &Client, claim: &mut Claim, cycles: u64) -> Result<(), Error> {
    for cycle in 0..cycles {
        let state = client.wait(PATIENCE)?;
        let swing = 0.002 * (cycle % 50) as f32;
        let hold = state
            .joints()
            .map(|joint| Setpoint::impedance(joint.position().unwrap() + swing, 0.0, 40.0, 1.0, 0.0));
        claim.send(&hold.collect::<Vec<_>>())?;
    }
    Ok(())
}

/// Runs of one client after another until `end`; returns how many ended as they should.
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
fn cycle_never_allocates_while_clients_connect_and_disconnect() {
    let me = nix::unistd::gettid().as_raw();
    assert_eq!(calls_of(me, || drop(std::hint::black_box(Box::new(7)))), (1, 1), "the counter counts");

    let runtime = tempfile::tempdir().unwrap();
    // SAFETY: this is the only test of this program, and no other thread looks at the environment yet.
    unsafe { std::env::set_var(RUNTIME_DIR_VARIABLE, runtime.path()) };
    let daemon = std::thread::spawn(|| motord::commands::run::run(Path::new(CONFIG)));
    let watcher = connect();
    await_cycles(&watcher, 10);

    let end = Arc::new(AtomicBool::new(false));
    let clients = [(); 2].map(|()| {
        std::thread::spawn({
            let end = Arc::clone(&end);
            move || run_clients(&end)
        })
    });
    let calls = calls_of(thread("motord-cycle"), || await_cycles(&watcher, CYCLES));
    end.store(true, Ordering::Relaxed);
    let whole_lives: u64 = clients.into_iter().map(|client| client.join().unwrap()).sum();

    kill(Pid::this(), Signal::SIGTERM).unwrap();
    daemon.join().unwrap().unwrap();
    assert!(whole_lives >= 4, "only {whole_lives} clients did all they should");
    assert_eq!(calls, (0, 0), "allocations and frees of the cycle thread in {CYCLES} cycles");
}

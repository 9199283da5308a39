"""Hostile peers of the page of motord-bridge, for test-bridge-web. `bridge-web.py PORT PID`; a failed check ends it with an error."""

import os
import random
import resource
import socket
import sys
import time
import urllib.request

port, pid = int(sys.argv[1]), int(sys.argv[2])
MOST_KB = 8 * 1024  # of growth
seed = int.from_bytes(os.urandom(4), "little")
random.seed(seed)
print(f"  seed {seed}")


def memory_kb():
    with open(f"/proc/{pid}/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS"))


def descriptors():
    return len(os.listdir(f"/proc/{pid}/fd"))


def connect():
    peer = socket.create_connection(("127.0.0.1", port), timeout=30)
    return peer


def answers(what):
    """The page answers within some attempts, beside the attack."""
    for attempt in range(50):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state", timeout=10) as answer:
                assert answer.status == 200
                return
        except OSError:
            time.sleep(0.1)
    raise AssertionError(f"no answer beside {what}")


def check(what):
    answers(what)
    grown, open_now = memory_kb() - before, descriptors()
    print(f"  {what}: {grown} kB more, {open_now} descriptors")
    assert grown < MOST_KB, "memory grows"
    assert open_now < before_descriptors + 100, "descriptors grow"


def send(data):
    try:
        with connect() as peer:
            peer.sendall(data)
            peer.shutdown(socket.SHUT_WR)
            peer.settimeout(10)
            while peer.recv(65536):
                pass
    except OSError:
        pass


soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 12000), hard))
answers("nothing")
before, before_descriptors = memory_kb(), descriptors()

peers, opened = [], 0
for number in range(10_000):
    try:
        peers.append(connect())
        opened += 1
    except OSError:
        pass
    if len(peers) >= 400:
        for peer in peers[:200]:
            peer.close()
        peers = peers[200:]
check(f"{opened} of 10000 silent connections")
assert opened > 9000

slow = []
for number in range(200):
    peer = connect()
    try:
        peer.sendall(b"POST /api/stop HTTP/1.1\r\nHost: 127")
        slow.append(peer)
    except OSError:
        pass
end = time.monotonic() + 5
while time.monotonic() < end:
    for peer in list(slow):
        try:
            peer.sendall(b".")
        except OSError:
            slow.remove(peer)
    time.sleep(0.2)
print(f"  {len(slow)} of 200 slow writers are left")
assert not slow, "slow writers stay"
check("200 slow writers")

readers = []
for number in range(40):
    peer = connect()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    peer.sendall(f"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    readers.append(peer)
time.sleep(15)
check("40 readers that never read")
for peer in readers:
    peer.close()

lines = [b"GET / HTTP/1.1\r\n", b"POST /api/stop HTTP/1.1\r\n", b"Host: 127.0.0.1\r\n", b"Content-Length: 99999999999\r\n",
         b"Transfer-Encoding: chunked\r\n", b"\r\n", b"ffffffffffffffff\r\n", b"Origin: \xff\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"]
for number in range(1500):
    if number % 2:
        send(os.urandom(random.randrange(1, 20_000)))
    else:
        send(b"".join(random.choice(lines) for _ in range(random.randrange(1, 40))))
check("1500 random requests")

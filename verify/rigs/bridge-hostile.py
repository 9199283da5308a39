"""Damaged DDS packets for test-bridge-ros2: `bridge-hostile.py SEED COUNT PORT...`.

Records packets of DDS on the loopback for 3 s, and sends COUNT of them to these ports, each with some bytes changed and some cut off;
and packets of random bytes.
"""

import os
import random
import socket
import sys
import time

ETH_P_ALL = 3


def record():
    sniffer = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    sniffer.settimeout(1)
    packets, end = [], time.monotonic() + 3
    while time.monotonic() < end and len(packets) < 4000:
        packet = sniffer.recv(65536)
        begin = packet.find(b"RTPS")
        if begin >= 0:
            packets.append(packet[begin:])
    return packets


def damaged(packets):
    if random.random() < 0.1:
        return b"RTPS\x02\x04\x01\x10" + os.urandom(random.randrange(12, 400))
    packet = bytearray(random.choice(packets))
    for _ in range(random.choice([1, 1, 2, 5, 30])):
        # Behind the header, without which no packet is read further.
        packet[random.randrange(8, len(packet))] = random.choice([0, 1, 0x7F, 0x80, 0xFF, random.randrange(256)])
    if random.random() < 0.2:
        del packet[random.randrange(1, len(packet)) :]
    return packet


def main():
    random.seed(int(sys.argv[1]))
    count, ports = int(sys.argv[2]), [int(port) for port in sys.argv[3:]]
    assert ports, "no ports"
    packets = record()
    assert len(packets) > 100, f"{len(packets)} packets of DDS"
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for number in range(count):
        try:
            sender.sendto(damaged(packets), ("127.0.0.1", random.choice(ports)))
        except OSError:
            # A port without a listener refuses.
            pass
        if number % 100 == 99:
            time.sleep(0.005)
    print(f"{count} damaged packets, made of {len(packets)}, to {ports}")


main()

"""Judges a recording of the mirror beside one of the robot, which began before it and ended after it.

    remote-records.py ROBOT.mcap ROBOT.json MIRROR.mcap MIRROR.json

The cycles that only the robot's recording has are those that the mirror's result counts as lost. Prints the numbers.
"""

import json
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def read(path: str) -> tuple[dict[int, int], int, dict[str, str]]:
    """The tick of each cycle, the number of setpoints of a joint, and the counts in the file."""
    decode, ticks, setpoints = DecoderFactory().decoder_for, {}, 0
    with open(path, "rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(topics=["/cycle", "/joints/fl-hip"]):
            decoded = decode(channel.message_encoding, schema)(message.data)
            if channel.topic == "/cycle":
                assert decoded.cycle not in ticks, f"{path}: cycle {decoded.cycle} is there twice"
                ticks[decoded.cycle] = decoded.tick_ns
            else:
                setpoints += decoded.HasField("setpoint")
        counts = next(record for record in reader.iter_metadata() if record.name == "motord.recording").metadata
    return ticks, setpoints, counts


def main() -> None:
    robot, _, _ = read(sys.argv[1])
    mirror, setpoints, counts = read(sys.argv[3])
    of_robot, of_mirror = (json.load(open(path, encoding="utf-8")) for path in (sys.argv[2], sys.argv[4]))
    whole = [of_robot[name] for name in ("lost", "dropped", "unpublished")]
    assert whole == [0, 0, 0], f"the robot's recording is not whole: {of_robot}"
    assert mirror.keys() <= robot.keys(), "the mirror's recording has cycles that the robot's has not"
    first, last = min(mirror), max(mirror)
    assert min(robot) < first and last < max(robot), "the robot's recording is too short"
    missing = sum(first < cycle < last for cycle in robot.keys() - mirror.keys())
    assert missing == of_mirror["lost"] == int(counts["lost"]), (missing, of_mirror, counts)
    assert of_mirror["recorded"] == len(mirror) and of_mirror["dropped"] == of_mirror["unpublished"] == 0, of_mirror
    assert setpoints > 0, "no setpoints"
    offsets = {mirror[cycle] - robot[cycle] for cycle in mirror}
    assert len(offsets) == 1, f"the clocks' offset is not one: {len(offsets)}"
    print(f"    {len(mirror)} cycles, {setpoints} setpoints of a joint, {missing} lost of {last - first + 1}: each is counted")


if __name__ == "__main__":
    main()

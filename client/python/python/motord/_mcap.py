"""The messages of an MCAP file, which may be cut off, damaged, of another program, or made to exhaust the computer."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from importlib import import_module
from io import BytesIO
from typing import Any, BinaryIO

from ._install import command
from ._signals import deferred

RECORD_BYTES_MAX = 16 << 20
"""Largest record, and largest chunk, compressed or not. The chunks of motord have a megabyte."""

EXPANSION_MAX = 256
"""Largest size of the records as a multiple of the bytes of the file. A recording of a robot at rest has 8 times its size."""

RECORDS_BYTES_MIN = 2 * RECORD_BYTES_MAX
"""Bytes of records that a file of any size may have."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
"""Kind and length of a record."""
_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, time and time of publication of a message."""
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_IN_CHUNK = (_SCHEMA, _CHANNEL, _MESSAGE)


class Damage(Exception):
    """The file ends, or is damaged, here."""


def messages(file: BinaryIO) -> Iterator[tuple[str, int, Any]]:
    """Yields topic, Unix time in ns, and the decoded message. Raises Damage where the file is cut off or excessive."""
    try:
        with deferred():
            from mcap.data_stream import ReadDataStream
            from mcap.records import Channel, Schema
            from mcap_protobuf.decoder import DecoderFactory
    except ImportError as error:
        raise ImportError(f"motord.Recording needs the MCAP library: {command('recording')}") from error

    factory = DecoderFactory()
    channels: dict[int, tuple[Channel, Callable[[bytes], Any] | None]] = {}
    schemas: dict[int, Schema] = {}

    def decoder(channel: Channel) -> Callable[[bytes], Any]:
        if channel.message_encoding == "json":
            return json.loads
        found = factory.decoder_for(channel.message_encoding, schemas.get(channel.schema_id))
        return found or (lambda data: data)

    try:
        for kind, body in _records(file):
            if kind == _MESSAGE:
                number, _, time, _ = _MESSAGE_HEAD.unpack_from(body)
                channel, decode = channels[number]
                if decode is None:
                    decode = decoder(channel)
                    channels[number] = channel, decode
                yield channel.topic, time, decode(body[_MESSAGE_HEAD.size :])
            elif kind == _SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(body)))
                schemas[schema.id] = schema
            elif kind == _CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(body)))
                # A file repeats its channels at its end.
                channels.setdefault(channel.id, (channel, None))
    except Damage:
        raise
    except Exception as error:  # the libraries raise what they meet
        raise Damage(f"{type(error).__name__}: {error}".rstrip(": ")) from error


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yields kind and content of the records, also of those in chunks. Checks sizes before anything is read or expanded."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk

    source = _Source(file)
    if source.read(len(_MAGIC)) != _MAGIC:
        raise Damage("it is no MCAP file")
    expanded = 0
    while True:
        crc = source.crc
        kind, length = _HEAD.unpack(source.read(_HEAD.size))
        if kind == 0 or length > RECORD_BYTES_MAX:
            raise Damage(f"a record of kind {kind} has {length} bytes; at most {RECORD_BYTES_MAX} are read")
        body = source.read(length)
        if kind == _FOOTER:
            return
        if kind == _DATA_END and struct.unpack_from("<I", body)[0] not in (0, crc):
            raise Damage("the check sum of the file is another")
        if kind != _CHUNK:
            yield kind, body
            continue
        data = _expanded(Chunk.read(ReadDataStream(BytesIO(body))))
        expanded += len(data)
        if expanded > RECORDS_BYTES_MIN + EXPANSION_MAX * source.count:
            raise Damage(f"it expands to more than {EXPANSION_MAX} times its size")
        yield from _of_chunk(data)


def _of_chunk(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(data):
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if kind == 0 or length > len(data) - at:
            raise Damage(f"a record of kind {kind} has {length} bytes, more than its chunk")
        if kind in _IN_CHUNK:
            yield kind, data[at : at + length]
        at += length


def _expanded(chunk: Any) -> bytes:
    """Returns the content of a chunk, whose check sum is right."""
    size: int = chunk.uncompressed_size
    if size > RECORD_BYTES_MAX:
        raise Damage(f"a chunk has {size} bytes; at most {RECORD_BYTES_MAX} are read")
    # One byte more shows that the size is wrong.
    data: bytes
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        import zstandard

        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        lz4: Any = import_module("lz4.frame")
        data = lz4.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise Damage(f"a chunk has the compression {chunk.compression}")
    if len(data) != size:
        raise Damage(f"a chunk has another size than {size} bytes")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise Damage("the check sum of a chunk is another")
    return data


class _Source:
    """The bytes of a file, with their number and their check sum."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.count = 0
        self.crc = 0

    def read(self, count: int) -> bytes:
        """Reads this number of bytes."""
        data = self._file.read(count)
        self.count += len(data)
        self.crc = zlib.crc32(data, self.crc)
        if len(data) < count:
            raise Damage("the end of the file is missing")
        return data

"""A recording read from front to back, as far as it is sound: what a crash or a bad disk left.

A chunk that fails its checksum is left out and counted; where the framing itself ends, so does
the scan. An MCAP file is whole when its summary at the end can be read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from spatial.errors import FileInputError

READ_ERRORS = (
    McapError,
    ValueError,  # bad checksum, text or number
    KeyError,
    struct.error,
    EOFError,
    RuntimeError,  # how lz4 refuses
    zstandard.ZstdError,
    MemoryError,
)
"""What the reading library raises on damaged bytes."""
MAX_RECORD_BYTES = 512 * 1024 * 1024


@dataclass(slots=True)
class Scan:
    """What a scan has met so far; complete once `records` is exhausted."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    """Schemas by id."""
    channels: dict[int, Channel] = field(default_factory=dict)
    """Channels by id."""
    bad_chunks: int = 0
    """Chunks that failed their checksum or did not unpack."""
    stopped: str = ""
    """Why the scan ended before the end mark; empty when it did not."""

    def records(self, file: BinaryIO) -> Iterator[Message | Attachment | Metadata]:
        """Yield messages, attachments and metadata in file order."""
        reader = StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)
        records = reader.records
        while True:
            try:
                record = next(records, None)
            except READ_ERRORS as error:
                self.stopped = f"{type(error).__name__}: {error}".strip(": ")
                return
            if record is None:
                return
            yield from self._sound(record)

    def _sound(self, record: McapRecord) -> Iterator[Message | Attachment | Metadata]:
        if not isinstance(record, Chunk):
            yield from self._sort([record])
            return
        try:
            records = breakup_chunk(record, validate_crc=True)
        except READ_ERRORS:
            self.bad_chunks += 1
            return
        yield from self._sort(records)

    def _sort(self, records: list[McapRecord]) -> Iterator[Message | Attachment | Metadata]:
        for record in records:
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Attachment | Metadata) or (
                isinstance(record, Message) and record.channel_id in self.channels
            ):
                yield record


def refuse_other_files(path: Path) -> None:
    """Refuse what is no recording at all.

    Raises:
        FileInputError: it does not exist, or does not begin as an MCAP file does.
    """
    try:
        with path.open("rb") as file:
            record = next(StreamReader(file, record_size_limit=MAX_RECORD_BYTES).records, None)
    except OSError as error:
        raise FileInputError(f"cannot read the recording: {error.strerror}", path=path) from error
    except InvalidMagic as error:
        raise FileInputError("not a recording: no MCAP mark at its start", path=path) from error
    except READ_ERRORS as error:
        raise FileInputError("nothing of this recording can be read", path=path) from error
    if not isinstance(record, Header):
        raise FileInputError("not a recording: no MCAP header", path=path)

"""Recordings on disk: open and iterate, say what is inside; `wire.repair` makes one whole.

A recording is MCAP: the bytes of the bus, channel = key without its session, log time = when the
recorder got it, publish time = capture stamp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.reader import SeekingReader, make_reader
from mcap.records import Attachment, Channel, Message, Statistics

from spatial.errors import FileInputError, unknown
from spatial.stamp import seconds
from wire.mcap_scan import READ_ERRORS, Scan, refuse_other_files


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message of a recording."""

    log_ns: int
    """When the recorder got it [ns]."""
    stamp_ns: int
    """Capture stamp [ns]; the log time where the message has none."""
    topic: str
    """Key without its session."""
    schema: str
    """Full name of the schema."""
    payload: bytes
    """The bytes as they were on the bus."""


@dataclass(frozen=True, slots=True)
class Stream:
    """One topic with one schema."""

    key: str
    """Key without its session."""
    schema: str
    """Full name of the schema."""
    count: int
    """Number of messages."""
    first_ns: int
    """Log time of the first [ns]."""
    last_ns: int
    """Log time of the last [ns]."""

    @property
    def hz(self) -> float:
        """Mean rate [1/s]; 0 for a single message."""
        span_s = seconds(self.last_ns - self.first_ns)
        return (self.count - 1) / span_s if span_s > 0 else 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the entry that `info` prints."""
        return {
            "key": self.key,
            "schema": self.schema,
            "count": self.count,
            "hz": round(self.hz, 3),
            "first_ns": self.first_ns,
            "last_ns": self.last_ns,
        }


class Recording:
    """A whole recording, read by its index; close it, best by `with`."""

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            FileInputError: not a recording, or not whole (`repair` makes it so).
        """
        refuse_other_files(path)
        self.path = path
        self._file = path.open("rb")
        self._reader = make_reader(self._file, validate_crcs=True)
        assert isinstance(self._reader, SeekingReader)  # a plain file can seek
        try:
            summary = self._reader.get_summary()
        except READ_ERRORS as error:
            self._file.close()
            raise _not_whole(path) from error
        if summary is None or summary.statistics is None:
            self._file.close()
            raise _not_whole(path)
        self._summary = summary
        self._statistics: Statistics = summary.statistics

    @property
    def interval_ns(self) -> tuple[int, int]:
        """Log times [ns] of the first and the last message; zeros without one."""
        return self._statistics.message_start_time, self._statistics.message_end_time

    @property
    def topics(self) -> list[str]:
        """Topics that exist, sorted."""
        return sorted({channel.topic for channel in self._summary.channels.values()})

    def streams(self) -> list[Stream]:
        """Return what is inside, by topic and schema."""
        bounds = {topic: self._bounds(topic) for topic in self.topics}
        counts = self._statistics.channel_message_counts
        return sorted(
            (
                Stream(c.topic, self._schema_name(c), counts.get(c.id, 0), *bounds[c.topic])
                for c in self._summary.channels.values()
            ),
            key=lambda stream: (stream.key, stream.schema),
        )

    def iterate(
        self,
        *,
        topics: list[str] | None = None,
        after_ns: int | None = None,
        until_ns: int | None = None,
        newest_first: bool = False,
    ) -> Iterator[Recorded]:
        """Yield messages in the order of their log times.

        Args:
            topics: only these; all without.
            after_ns: only log times after it [ns].
            until_ns: only log times up to it, itself included [ns].
            newest_first: the other way round.

        Raises:
            FileInputError: a topic that is not inside, or bytes that fail their checksum.
        """
        for topic in topics or []:
            if topic not in self.topics:
                raise FileInputError(unknown("topic", topic, self.topics), path=self.path)
        if after_ns is not None and until_ns is not None and after_ns >= until_ns:
            return
        try:
            for schema, channel, message in self._reader.iter_messages(
                topics=topics,
                starting_after=after_ns,
                ending_at=until_ns,
                reverse=newest_first,
            ):
                yield Recorded(
                    log_ns=message.log_time,
                    stamp_ns=message.publish_time,
                    topic=channel.topic,
                    schema=schema.name if schema is not None else "",
                    payload=message.data,
                )
        except READ_ERRORS as error:
            raise FileInputError(f"damaged recording: {error}; try repair", path=self.path) from (
                error
            )

    def last_before(
        self, topic: str, stamp_ns: int, *, within_ns: int | None = None
    ) -> Recorded | None:
        """Return the newest message of a topic at or before a log time [ns].

        Args:
            topic: its key without session.
            stamp_ns: the log time [ns].
            within_ns: how far back to look [ns]; to the start without.

        Raises:
            FileInputError: as `iterate`.
        """
        after_ns = None if within_ns is None else max(0, stamp_ns - within_ns)
        found = self.iterate(
            topics=[topic], after_ns=after_ns, until_ns=stamp_ns, newest_first=True
        )
        return next(found, None)

    def attachments(self) -> dict[str, bytes]:
        """Return attachments by name, the last one of each name."""
        return {entry.name: entry.data for entry in self._reader.iter_attachments()}

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return what the recorder wrote about itself, by name."""
        return {entry.name: entry.metadata for entry in self._reader.iter_metadata()}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    def _bounds(self, topic: str) -> tuple[int, int]:
        first = next(self.iterate(topics=[topic]), None)
        last = next(self.iterate(topics=[topic], newest_first=True), None)
        return (0, 0) if first is None or last is None else (first.log_ns, last.log_ns)

    def _schema_name(self, channel: Channel) -> str:
        schema = self._summary.schemas.get(channel.schema_id)
        return schema.name if schema is not None else ""


def info(path: Path) -> dict[str, Any]:
    """Return what `telepresence info` prints, also of a recording that is not whole.

    Raises:
        FileInputError: not a recording.
    """
    try:
        with Recording(path) as recording:
            streams, names = recording.streams(), sorted(recording.attachments())
            return _info(path, whole=True, streams=streams, attachments=names, warnings=[])
    except FileInputError:
        refuse_other_files(path)
    scan, streams, names = _scan(path)
    warnings = [f"not whole ({scan.stopped or 'no index'}): repair makes it so"]
    if scan.bad_chunks:
        warnings.append(f"{scan.bad_chunks} chunks fail their checksum")
    return _info(path, whole=False, streams=streams, attachments=names, warnings=warnings)


def _info(
    path: Path, *, whole: bool, streams: list[Stream], attachments: list[str], warnings: list[str]
) -> dict[str, Any]:
    full = [stream for stream in streams if stream.count > 0]
    first = min((stream.first_ns for stream in full), default=0)
    last = max((stream.last_ns for stream in full), default=0)
    return {
        "file": str(path),
        "whole": whole,
        "duration_s": seconds(last - first),
        "streams": [stream.as_json() for stream in streams],
        "attachments": attachments,
        "warnings": warnings
        + [f"no schema for {s.key}: other tools cannot read it" for s in full if not s.schema]
        + ([] if full else ["no message inside"]),
    }


def _scan(path: Path) -> tuple[Scan, list[Stream], list[str]]:
    scan, names = Scan(), []
    seen: dict[int, tuple[int, int, int]] = {}
    with path.open("rb") as file:
        for record in scan.records(file):
            if isinstance(record, Message):
                count, first, last = seen.get(record.channel_id, (0, record.log_time, 0))
                seen[record.channel_id] = (
                    count + 1,
                    min(first, record.log_time),
                    max(last, record.log_time),
                )
            elif isinstance(record, Attachment):
                names.append(record.name)
    streams = []
    for channel_id, (count, first, last) in seen.items():
        channel = scan.channels[channel_id]
        schema = scan.schemas.get(channel.schema_id)
        name = schema.name if schema is not None else ""
        streams.append(Stream(channel.topic, name, count, first, last))
    return scan, sorted(streams, key=lambda s: (s.key, s.schema)), sorted(names)


def _not_whole(path: Path) -> FileInputError:
    return FileInputError(
        "the recording is not whole, its end is missing: `telepresence repair` makes it so",
        path=path,
    )

"""Makes a damaged recording whole: everything that is sound, with a new index."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import Writer

from spatial.errors import FileInputError
from wire.mcap_scan import Scan, refuse_other_files
from wire.mcap_writer import finish, open_writer
from wire.recording import Recording


@dataclass(frozen=True, slots=True)
class Repair:
    """What a repair did."""

    file: Path
    """The whole recording."""
    damaged: Path | None
    """The damaged one; `None` when there was nothing to do."""
    messages: int
    """Messages saved."""
    lost_chunks: int
    """Chunks that failed their checksum."""


def repair(path: Path, *, out: Path | None = None) -> Repair:
    """Make a recording whole; in place it keeps the damaged one as `FILE.damaged`.

    Args:
        path: the recording.
        out: where to write the whole one; in place without.

    Raises:
        FileInputError: not a recording, or `out` exists.
    """
    refuse_other_files(path)
    if out is not None and out.exists():
        raise FileInputError("the file to repair into exists already", path=out)
    if out is None and _sound(path):
        return Repair(file=path, damaged=None, messages=0, lost_chunks=0)
    target = out or path.with_name(f"{path.name}.repairing")
    scan, messages = _copy(path, target)
    if out is not None:
        return Repair(file=out, damaged=path, messages=messages, lost_chunks=scan.bad_chunks)
    damaged = _free_name(path)
    path.rename(damaged)
    target.rename(path)
    return Repair(file=path, damaged=damaged, messages=messages, lost_chunks=scan.bad_chunks)


def _sound(path: Path) -> bool:
    """Return whether it is whole and every chunk passes its checksum."""
    try:
        with Recording(path) as recording:
            for _ in recording.iterate():
                pass
    except FileInputError:
        return False
    return True


def _copy(path: Path, target: Path) -> tuple[Scan, int]:
    scan, messages = Scan(), 0
    with path.open("rb") as source, target.open("wb") as sink:
        writer = open_writer(sink)
        schemas: dict[int, int] = {0: 0}
        channels: dict[int, int] = {}
        for record in scan.records(source):
            if isinstance(record, Message):
                if record.channel_id not in channels:
                    channel = scan.channels[record.channel_id]
                    channels[channel.id] = _register(writer, channel, scan.schemas, schemas)
                writer.add_message(
                    channel_id=channels[record.channel_id],
                    log_time=record.log_time,
                    data=record.data,
                    publish_time=record.publish_time,
                    sequence=record.sequence,
                )
                messages += 1
            elif isinstance(record, Attachment):
                writer.add_attachment(
                    record.create_time, record.log_time, record.name, record.media_type, record.data
                )
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
        finish(writer)
    return scan, messages


def _register(
    writer: Writer, channel: Channel, known: dict[int, Schema], schemas: dict[int, int]
) -> int:
    if channel.schema_id not in schemas:
        schema = known.get(channel.schema_id)
        schemas[channel.schema_id] = (
            writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
        )
    return writer.register_channel(
        channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
    )


def _free_name(path: Path) -> Path:
    """Return `FILE.damaged`, numbered when an older one lies there."""
    candidate, number = path.with_name(f"{path.name}.damaged"), 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}.damaged{number}")
    return candidate

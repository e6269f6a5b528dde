"""One way of writing MCAP: lz4, chunks of 1 MB."""

from __future__ import annotations

from typing import BinaryIO

from mcap.writer import CompressionType, Writer

CHUNK_BYTES = 1024 * 1024
LIBRARY = "telepresence"


def open_writer(sink: BinaryIO) -> Writer:
    """Return a writer that has begun a file."""
    writer = Writer(sink, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
    writer.start(profile="", library=LIBRARY)
    return writer


def flush(writer: Writer) -> None:
    """End the chunk and hand everything to the system; it survives the death of the process."""
    writer.flush()  # type: ignore[no-untyped-call]  # mcap names no return type


def finish(writer: Writer) -> None:
    """Write the index; the file is whole from here on."""
    writer.finish()  # type: ignore[no-untyped-call]  # mcap names no return type

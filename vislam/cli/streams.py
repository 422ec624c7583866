"""Standard output and error that outlast their reader."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from vislam.base.legible import visible_lines


@contextmanager
def lasting_streams() -> Iterator[None]:
    """Let the block write to streams that may be closed or full: they fall silent, and the work goes on.

    What goes to standard error has no escape sequences; what the encoding lacks becomes an escape on both.
    """
    before = sys.stdout, sys.stderr
    ours = _Lasting(sys.stdout, 1, plain=False), _Lasting(sys.stderr, 2, plain=True)
    sys.stdout, sys.stderr = ours
    try:
        yield
    finally:
        for stream in ours:
            stream.flush()
        sys.stdout, sys.stderr = before


class _Lasting(io.TextIOBase):
    """Passes a text on as long as there is somebody who takes it."""

    def __init__(self, stream: TextIO | None, descriptor: int, *, plain: bool) -> None:
        self._stream, self._plain = stream, plain
        if stream is None:
            _occupy(descriptor)

    def write(self, text: str) -> int:
        """Write, or do nothing."""
        self._pass_on(visible_lines(text) if self._plain else text)
        return len(text)

    def flush(self) -> None:
        """Flush, or do nothing."""
        self._pass_on(None)

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def fileno(self) -> int:
        """Descriptor; OSError without one."""
        return super().fileno() if self._stream is None else self._stream.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _pass_on(self, text: str | None) -> None:
        """Write a text, or flush if there is none."""
        if self._stream is None:
            return
        try:
            if text is None:
                self._stream.flush()
            else:
                self._stream.write(text)
        except UnicodeEncodeError:
            assert text is not None
            self._pass_on(text.encode(self.encoding, "backslashreplace").decode(self.encoding))
        except (OSError, ValueError):
            self._fall_silent(self._stream)

    def _fall_silent(self, stream: TextIO) -> None:
        """Let nothing be written any more, by the interpreter at its end neither, which would fail of it."""
        self._stream = None
        with suppress(OSError, ValueError):
            descriptor = stream.fileno()
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, descriptor)
            os.close(nowhere)


def _occupy(descriptor: int) -> None:
    """Have the descriptor of a closed stream lead nowhere, or the next file that is opened would have it."""
    try:
        os.fstat(descriptor)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != descriptor:
            os.dup2(nowhere, descriptor)
            os.close(nowhere)

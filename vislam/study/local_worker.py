"""What each worker process of this machine loads as it starts."""

import signal
from typing import Any

# A worker that has imported what it needs before its first trial is as quick with it as with the others.
import gtsam  # noqa: F401

import vislam.study.trial  # noqa: F401


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the study, which then ends its workers; Dask calls this in the worker's main thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The process that started this one had its signals wait; as its parent dies, it is ended by one.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})

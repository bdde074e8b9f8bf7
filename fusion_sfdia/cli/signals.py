"""SIGINT and SIGTERM: a command ends by them in order, and a watch within a second whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 0.4  # s from a signal to the next attempt
EACH = 0.1  # s between attempts
LAST = 0.9  # s from a signal to the end of the process, where no attempt has helped


class InterruptedBySignal(KeyboardInterrupt):
    """Of its own class: after a KeyboardInterrupt itself within `exec`, as dataclasses use it, CPython ends by SIGINT."""


class Interruption:
    """Signals that end this process, while `handled` lasts.

    A signal raises KeyboardInterrupt in the main thread, within `deferred` at its end, a second one at once. Compiled code that
    calls back into Python discards it: `number` keeps it, and the signal is raised again until `acknowledge` is called. save:
    what is to be done before the process ends.
    """

    def __init__(self) -> None:
        self.number = 0  # of the signal, 0 before one has come
        self.busy = False
        self.acknowledged = threading.Event()
        self.save: Callable[[], object] = lambda: None

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Of a signal that has come."""
        first, self.number = not self.number, number
        if not (self.acknowledged.is_set() or (first and self.busy)):
            raise InterruptedBySignal

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """A block that a signal does not interrupt, but ends."""
        self.busy = True
        try:
            yield
        finally:
            self.busy = False
        if self.number and not self.acknowledged.is_set():
            raise InterruptedBySignal

    def acknowledge(self) -> None:
        """The command is ending: further signals are without effect."""
        self.acknowledged.set()

    @property
    def code(self) -> int:
        """The exit status by the convention of shells, 128 and the number of the signal."""
        return 128 + (self.number or signal.SIGINT)


@contextmanager
def handled() -> Iterator[Interruption]:
    """Within the block signals raise KeyboardInterrupt in the main thread. In other threads nothing is changed."""
    found = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield found
        return
    heard = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]  # as under nohup
    before = {number: signal.signal(number, found.handle) for number in heard}
    hook, sys.unraisablehook = sys.unraisablehook, _without_interruptions(sys.unraisablehook)
    try:
        yield found
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ended_in_time(interruption: Interruption) -> Iterator[None]:
    """Within the block a signal ends this process after LAST seconds at most.

    A signal that compiled code has discarded is sent again; where that does not help, for instance in a compiler, another
    thread calls `interruption.save` and ends the process.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    main, (read, write) = threading.get_ident(), os.pipe()
    if hasattr(os, "set_blocking"):  # Windows has it from Python 3.12 on, and needs it of no pipe
        os.set_blocking(write, False)
    ended = threading.Event()

    def guard() -> None:
        came = 0
        while came not in SIGNALS and (byte := os.read(read, 1)):
            came = byte[0]
        if came not in SIGNALS or ended.wait(PATIENCE):
            return
        for _ in range(round((LAST - PATIENCE) / EACH)):
            if not interruption.acknowledged.is_set():
                _send(came, main)
            if ended.wait(EACH):
                return
        with suppress(Exception):
            interruption.save()
        os._exit(128 + came)

    thread = threading.Thread(target=guard, daemon=True)
    thread.start()
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(before)
        os.close(write)  # which ends the thread
        thread.join()
        os.close(read)


def _send(number: int, thread: int) -> None:
    """Send a signal to a thread of this process; Windows has no signals of threads, and Python handles any in the main one."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(thread, number)
    else:
        signal.raise_signal(number)


def _without_interruptions(hook: Callable[[Any], object]) -> Callable[[Any], object]:
    """The hook for errors that nothing catches, silent about an interruption in a callback of compiled code."""

    def report(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            hook(unraisable)

    return report

"""What the person at the terminal sees of a run, and log.jsonl."""

import json
import sys
import time
from pathlib import Path
from typing import TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from graphgs.progress import Reporter

PLAIN_INTERVAL_S = 10.0  # between two progress lines where there is no terminal


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Rich would exit with code 1, which says bug here: let the command line answer it."""
        raise  # the BrokenPipeError that is being handled


class RunReporter(Reporter):
    """Writes events to log.jsonl; shows progress: a bar on a terminal, plain lines elsewhere, JSON on demand."""

    def __init__(self, *, as_json: bool = False, quiet: bool = False, stream: TextIO | None = None):
        self.warnings: list[str] = []
        self._as_json, self._quiet = as_json, quiet
        self._console = _Console(file=stream or sys.stdout, highlight=False, soft_wrap=True)
        self._log: TextIO | None = None
        self._bar: Progress | None = None
        self._task = None
        self._title = ""
        self._began = self._last_line = time.monotonic()
        self._counted = self._total = 0  # of the work that progress is told of
        self._from = (self._began, 0)  # when that work began, and how much was done then

    def attach_log(self, path: Path) -> None:
        """From here on every event is also appended to `path`."""
        self._log = path.open("a", encoding="utf-8")

    def close(self) -> None:
        self._end_bar()
        if self._log is not None:
            self._log.close()
            self._log = None

    def stage(self, number: int, total: int, title: str) -> None:
        """A stage begins; `title` says in a few words what it does."""
        self._end_bar()
        self._title = title
        self._began = self._last_line = time.monotonic()
        self._say(f"[bold]\\[{number}/{total}][/bold] {escape(title)}")

    def progress(self, done: int, total: int, note: str = "") -> None:
        if total != self._total or done < self._counted:  # other work
            self._from = (time.monotonic(), done)
        self._counted, self._total = done, total
        if self._as_json:
            self._emit("progress", {"stage": self._title, "done": done, "total": total, "note": note}, log=False)
        elif self._quiet:
            return
        elif self._console.is_terminal:
            self._show_bar(done, total, note)
        else:
            now = time.monotonic()
            if now - self._last_line >= PLAIN_INTERVAL_S:
                self._last_line = now
                elapsed = now - self._began
                self._say(f"      {done}/{total} {escape(note)} ({elapsed:.0f} s{self._left(done, total, now)})")

    def _left(self, done: int, total: int, now: float) -> str:
        """e.g. ", 40 s left" at the pace so far; nothing where there is none yet."""
        began, first = self._from
        if not first < done < total:
            return ""
        return f", {(now - began) * (total - done) / (done - first):.0f} s left"

    def event(self, kind: str, **fields) -> None:
        self._emit(kind, fields)

    def info(self, message: str) -> None:
        self._end_bar()
        self._emit("info", {"message": message})
        self._say(f"      {escape(printable(message))}")

    def warn(self, message: str) -> None:
        self._end_bar()
        self.warnings.append(message)
        self._emit("warning", {"message": message})
        self._say(f"      [yellow]warning:[/yellow] {escape(printable(message))}")

    def _emit(self, kind: str, fields: dict, *, log: bool = True) -> None:
        line = json.dumps({"time": round(time.time(), 3), "event": kind, **fields}, default=str)
        if log and self._log is not None:
            self._log.write(line + "\n")
            self._log.flush()
        if self._as_json:
            print(line, file=self._console.file, flush=True)

    def _say(self, markup: str) -> None:
        if not self._as_json and not self._quiet:
            self._console.print(markup)

    def _show_bar(self, done: int, total: int, note: str) -> None:
        if self._bar is None:
            columns = (TextColumn("     "), BarColumn(30), TaskProgressColumn(), TimeRemainingColumn())
            self._bar = Progress(*columns, TextColumn("{task.description}"), console=self._console, transient=True)
            self._bar.start()
            self._task = self._bar.add_task("", total=total)
        self._bar.update(self._task, completed=done, total=total, description=escape(printable(note)))

    def _end_bar(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def printable(text: str) -> str:
    """Control characters (file names may hold any) shown, not sent to the terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

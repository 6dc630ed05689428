"""How a stage speaks while it works. Stages get a Reporter; what happens to the words is decided in the CLI."""


class Reporter:
    """Receives progress and events. This base class is silent: the default for library use and tests."""

    def progress(self, done: int, total: int, note: str = "") -> None:
        """`done` of `total` units of the current stage are finished; `note` is a few words, e.g. the loss."""

    def event(self, kind: str, **fields) -> None:
        """Something worth keeping in log.jsonl, e.g. event("pairs", candidates=247, exhaustive=1225)."""

    def info(self, message: str) -> None:
        """One line a person would want to read."""

    def warn(self, message: str) -> None:
        """Something went less well than hoped and the result may suffer: what, and what to do."""

"""A wall-clock limit, and whether anything was left undone because of it."""

import time


class Limit:
    """Say when time is up; remember that somebody was told so."""

    def __init__(self, seconds: float | None) -> None:
        self._end = None if seconds is None else time.monotonic() + seconds
        self.stopped = False  # True: some work was cut short, and another run may end elsewhere

    def over(self) -> bool:
        """Return whether to stop; whoever asks must have work left that it leaves undone then."""
        self.stopped |= self._end is not None and time.monotonic() > self._end
        return self.stopped

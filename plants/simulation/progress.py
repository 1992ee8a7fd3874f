"""A bar that says that the first batch is being compiled, instead of an arrival in ten hours."""

import threading

from tqdm import tqdm

PATIENCE = 2.0  # s without a bar


class Bar:
    """Progress of `total` runs on the terminal; a context that ends with the bar."""

    def __init__(self, total: int, what: str = "runs", *, shown: bool = True, compiling: str = "compiling") -> None:
        self._bar = tqdm(total=total, desc=compiling, bar_format="{desc} {elapsed}", delay=PATIENCE, disable=not shown)
        self._what, self._first, self._stored = what, True, 0
        self._timer = threading.Timer(PATIENCE, self._bar.refresh)  # tqdm itself waits for the first batch
        self._timer.daemon = True
        if shown:
            self._timer.start()

    def already(self, runs: int) -> None:
        """So many need not be flown."""
        self._stored = runs

    def update(self, runs: int) -> None:
        """So many more have come; the first do not count for the rate, because they were compiled."""
        self._timer.cancel()
        if self._first:
            self._first = False
            self._bar.bar_format = None
            self._bar.set_description(self._what, refresh=False)
            self._bar.reset()
            self._bar.initial = self._bar.n = self._bar.last_print_n = self._stored + runs
            self._bar.refresh()
        else:
            self._bar.update(runs)

    def reach(self, runs: int) -> None:
        """So many have come altogether."""
        if runs > self._bar.n:
            self.update(runs - self._bar.n)

    def tell(self, text: str) -> None:
        """A line above the bar."""
        self._bar.write(text)

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        self._bar.close()

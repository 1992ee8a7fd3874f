"""BLAS on one thread while small matrices are worked on: its threads cost several times more than they bring."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")


@functools.cache
def _controller() -> ThreadpoolController:
    """The BLAS libraries that are loaded; looked for once."""
    return ThreadpoolController()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """The function with BLAS limited to one thread while it runs, for the whole process."""

    @functools.wraps(function)
    def limited(*arguments: P.args, **options: P.kwargs) -> T:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*arguments, **options)

    return limited

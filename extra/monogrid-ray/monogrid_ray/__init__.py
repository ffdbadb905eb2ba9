"""The tasks of `monogrid batch` on a Ray cluster, with sources and results in object stores."""

from .driver import Batch, run

__all__ = ["Batch", "run"]

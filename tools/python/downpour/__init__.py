# SPDX-License-Identifier: Apache-2.0
"""Fast Gaussian-process queries, batched policy rollouts on them, CMA-ES and Black-DROPS.

GaussianProcess, Evaluator, CMAES, learn and make are all of it; their docstrings tell shapes, units
and errors, docs/evaluator.md shows whole programs. Arrays are NumPy's; C-contiguous float64 goes in
without a copy. Everything is deterministic: equal arguments give equal bits, whatever the number of
threads. Long calls release the GIL.
"""
from downpour import _process

_process.prepare()

from downpour._core import (CMAES, Env, Evaluator, GaussianProcess, LearnResult, Policy,  # noqa: E402
                            __version__, learn, make, tasks)
from downpour._process import doctor  # noqa: E402

__all__ = ["CMAES", "Env", "Evaluator", "GaussianProcess", "LearnResult", "Policy", "__version__",
           "doctor", "learn", "make", "tasks"]

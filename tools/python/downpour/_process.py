# SPDX-License-Identifier: Apache-2.0
"""Settings that OpenBLAS and OpenMP read from the environment while they load.

OpenBLAS 0.3.21 runs SSE3 kernels on CPUs newer than itself, six times slower than those the CPU has;
OPENBLAS_CORETYPE names the kernels to use. OpenMP threads that wait spin for long, and so keep a core
from others; GOMP_SPINCOUNT bounds that. The command sets both and starts itself again; a module can
only set them in time, which it can unless NumPy, say, has loaded the same libraries before.
"""
import _ctypes
import collections
import ctypes
import os
import warnings

CMAESResult = collections.namedtuple(
    "CMAESResult", "xbest fbest evaluations iterations xfavorite sigma restarts stop")

_AVX512 = {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}
_AVX2 = {"avx2", "fma", "bmi1", "bmi2", "f16c"}
_WIDTH = {"SkylakeX": 8, "Cooperlake": 8, "SapphireRapids": 8, "Haswell": 4, "Zen": 4}

# What prepare() found and did.
_notes = {"blas_loaded_before": False, "openmp_loaded_before": False, "blas_core_mended": False}


def _loaded(library):
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
            return any(library in line for line in maps)
    except OSError:
        return False


def _suitable_core():
    """The kernel family of OpenBLAS that suits this CPU; "" where any choice of its own stands."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as info:
            flags = next((set(line.split(":", 1)[1].split()) for line in info
                          if line.startswith("flags")), set())
    except OSError:
        return ""
    if _AVX512 <= flags:
        return "SkylakeX"
    return "Haswell" if _AVX2 <= flags else ""


def _own_choice():
    """The family that OpenBLAS chooses by itself, found by loading it and letting it go again."""
    try:
        library = ctypes.CDLL("libopenblas.so.0")
        library.openblas_get_corename.restype = ctypes.c_char_p
        core = library.openblas_get_corename().decode()
    except (OSError, AttributeError):
        return None
    # The extension loads it anew, from where it was linked and by the settings made by then.
    _ctypes.dlclose(library._handle)
    return core


def prepare():
    """Before the extension loads the libraries; what the user has set stays."""
    _notes["openmp_loaded_before"] = _loaded("libgomp")
    _notes["blas_loaded_before"] = _loaded("libopenblas.so")
    if not _notes["openmp_loaded_before"] and not {"OMP_WAIT_POLICY",
                                                   "GOMP_SPINCOUNT"} & os.environ.keys():
        os.environ["OMP_WAIT_POLICY"] = "passive"
        os.environ["GOMP_SPINCOUNT"] = "2000"
    if _notes["blas_loaded_before"] or "OPENBLAS_CORETYPE" in os.environ:
        return
    core = _own_choice()
    suitable = _suitable_core()
    if core is not None and _WIDTH.get(core, 2) < _WIDTH.get(suitable, 2):
        os.environ["OPENBLAS_CORETYPE"] = suitable
        _notes["blas_core_mended"] = True


def _advice():
    """What slows this process down, one sentence each."""
    from downpour import _core
    core, suitable = _core.blas_core(), _core.suitable_blas_core()
    if not _core.is_weaker_blas_core(core, suitable):
        return []
    cause = ("it was loaded before downpour: import downpour before numpy, or set "
             if _notes["blas_loaded_before"] else "set ")
    return [f"OpenBLAS runs its {core} kernels, which are slow on this CPU; {cause}"
            f"OPENBLAS_CORETYPE={suitable}"]


def warn_of_slow_blas():
    for advice in _advice():
        warnings.warn(advice, RuntimeWarning, stacklevel=2)


def doctor():
    """doctor() -> dict

    What this process gives the package, and, under "warnings", what slows it down: version, simd (the
    instruction set of the kernels), blas_core (the kernels that OpenBLAS runs, whose numbers decide
    the last bits of factors), blas_core_mended (whether the package corrected OpenBLAS's choice),
    blas_loaded_before and openmp_loaded_before (whether another module had loaded the library, which
    then has its own settings), cores.
    """
    from downpour import _core
    return {"version": _core.__version__, "simd": _core.simd_target(),
            "blas_core": _core.blas_core(), **_notes, "cores": len(os.sched_getaffinity(0)),
            "warnings": _advice()}

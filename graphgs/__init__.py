"""GraphGS: photos without camera poses in, a trained 3D Gaussian Splatting scene out."""

from pathlib import Path

from graphgs.threads import get_num_threads, set_num_threads

__version__ = "0.1.0"
__all__ = ["RunResult", "get_num_threads", "run", "set_num_threads"]

# Device code lives in the checkout's top-level `kernels/` and is installed as `graphgs.kernels`. In a checkout (or an
# editable install) there is no graphgs/kernels folder, so the checkout itself joins this package's search path.
_here = Path(__file__).resolve().parent
if not (_here / "kernels").is_dir() and (_here.parent / "kernels" / "launch.py").is_file():
    __path__.append(str(_here.parent))


def __getattr__(name: str):
    """Load the pipeline (torch, Warp, Taichi) only when it is first asked for."""
    if name in ("run", "RunResult"):
        from graphgs import api

        return getattr(api, name)
    raise AttributeError(f"module 'graphgs' has no attribute {name!r}")

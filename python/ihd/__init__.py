"""R(t) and L(t) of an induction hob's load from coil voltage and current.

    capture = ihd.read("scope.csv")
    found = capture.identify()
    found.t, found.R, found.sigma_R, found.verdict

Units are SI (s, V, A, ohm, H, Hz) unless a name ends with another one.
"""

from importlib.metadata import version as _version

from ._native import CaptureError, IdentifyError, StoreError, methods, presets
from .api import DaemonError, LeaseError, Stream
from .captures import Capture, CaptureWarning, Truth, identify, read, simulate
from .daemon import Curve, Daemon, Device, Window
from .identification import Estimate, Finding, HalfCycle, Identification, Law, Verdict
from .lease import Lease
from .store import Columns, Store

__version__ = _version("ihd")

__all__ = [
    "Capture",
    "CaptureError",
    "CaptureWarning",
    "Columns",
    "Curve",
    "Daemon",
    "DaemonError",
    "Device",
    "Estimate",
    "Finding",
    "HalfCycle",
    "Identification",
    "IdentifyError",
    "Law",
    "Lease",
    "LeaseError",
    "Store",
    "StoreError",
    "Stream",
    "Truth",
    "Verdict",
    "Window",
    "identify",
    "methods",
    "presets",
    "read",
    "simulate",
]

"""Hue-preserving compositing of premultiplied RGBA layers, on arrays and on files.

Colours are labels: where translucent ones overlap, ⊕ keeps every hue one of those that went in.
Chuang, Weiskopf, Möller: Hue-Preserving Color Blending, IEEE TVCG 15(6), 2009.

    composite         stack of arrays (…, 4) -> array
    hue_add           c1 ⊕ c2 of colours (…, 3)
    hue_histogram     pixels (…, 4) -> how many have which hue
    stack_measures    what compositing arrays does to their hues, in numbers
    stack             layer files -> one file, as `hpcomp stack`
    flatten           deep files -> one flat file, as `hpcomp flatten`
    read_layer        one layer of a file -> pixels and windows
    write_image       pixels -> a file
    info              what a file holds and how it will be read
    read_hues         the hue histogram of a file, strip by strip
    write_hue_report  histograms -> text, data, a figure or a page, as `hpcomp hues`
    explain           how one pixel of a stack of files comes about
    check             a picture against the layers it was made from, by rules
    batch             many stacks, several at a time, as `hpcomp batch`
    frame_jobs        a sequence of numbered files -> jobs
    read_jobs         a job file -> jobs
    save_jobs         jobs -> a job file
    palette           what the colours of labels blend to, and what may go wrong with them
    write_palette_report  that as text, data or a figure, as `hpcomp palette`

Names are imported on first use, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .arrays import composite as composite
    from .arrays import hue_add as hue_add
    from .checking import CheckResult as CheckResult
    from .checking import check as check
    from .encoding import Losses as Losses
    from .errors import ExitCode as ExitCode
    from .errors import HpcompError as HpcompError
    from .errors import HpcompWarning as HpcompWarning
    from .errors import InputError as InputError
    from .errors import InputWarning as InputWarning
    from .errors import MismatchError as MismatchError
    from .errors import OutputError as OutputError
    from .errors import SettingError as SettingError
    from .explanation import PixelExplanation as PixelExplanation
    from .explanation import explain as explain
    from .flattening import flatten as flatten
    from .geometry import Window as Window
    from .histogram import HueHistogram as HueHistogram
    from .histogram import hue_histogram as hue_histogram
    from .imagefile import ImageFile as ImageFile
    from .imagefile import LayerImage as LayerImage
    from .imagehues import read_hues as read_hues
    from .jobs.batch import BatchResult as BatchResult
    from .jobs.batch import JobRecord as JobRecord
    from .jobs.batch import batch as batch
    from .jobs.frames import frame_jobs as frame_jobs
    from .jobs.jobfile import read_jobs as read_jobs
    from .jobs.jobfile import save_jobs as save_jobs
    from .jobs.schema import Job as Job
    from .measures import StackMeasures as StackMeasures
    from .measures import stack_measures as stack_measures
    from .orders import ORDERS as ORDERS
    from .palettes import Palette as Palette
    from .palettes import palette as palette
    from .pipeline import StackResult as StackResult
    from .pipeline import info as info
    from .pipeline import read_layer as read_layer
    from .pipeline import stack as stack
    from .pipeline import write_image as write_image
    from .porter_duff import OPERATORS as OPERATORS
    from .report.formats import write_hue_report as write_hue_report
    from .report.paletteformats import write_palette_report as write_palette_report
    from .spaces import SPACES as SPACES
    from .stackfile import LayerSpec as LayerSpec

# Where each name lives; the imports above say the same to type checkers.
_HOME = {
    "BatchResult": ".jobs.batch",
    "JobRecord": ".jobs.batch",
    "batch": ".jobs.batch",
    "CheckResult": ".checking",
    "check": ".checking",
    "composite": ".arrays",
    "hue_add": ".arrays",
    "Losses": ".encoding",
    "ExitCode": ".errors",
    "HpcompError": ".errors",
    "HpcompWarning": ".errors",
    "InputError": ".errors",
    "InputWarning": ".errors",
    "MismatchError": ".errors",
    "OutputError": ".errors",
    "SettingError": ".errors",
    "PixelExplanation": ".explanation",
    "explain": ".explanation",
    "flatten": ".flattening",
    "frame_jobs": ".jobs.frames",
    "Window": ".geometry",
    "HueHistogram": ".histogram",
    "hue_histogram": ".histogram",
    "ImageFile": ".imagefile",
    "LayerImage": ".imagefile",
    "read_hues": ".imagehues",
    "Job": ".jobs.schema",
    "read_jobs": ".jobs.jobfile",
    "save_jobs": ".jobs.jobfile",
    "StackMeasures": ".measures",
    "stack_measures": ".measures",
    "ORDERS": ".orders",
    "Palette": ".palettes",
    "palette": ".palettes",
    "StackResult": ".pipeline",
    "info": ".pipeline",
    "read_layer": ".pipeline",
    "stack": ".pipeline",
    "write_image": ".pipeline",
    "OPERATORS": ".porter_duff",
    "write_hue_report": ".report.formats",
    "write_palette_report": ".report.paletteformats",
    "SPACES": ".spaces",
    "LayerSpec": ".stackfile",
}

__all__ = ["__version__", *_HOME]


if not TYPE_CHECKING:  # a type checker would take it for permission to use any name

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'hpcomp' has no attribute '{name}'")
        value = getattr(import_module(_HOME[name], __name__), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)

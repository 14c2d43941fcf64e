"""Hue-preserving compositing of premultiplied RGBA layers, on arrays and on files.

Colours are labels: where translucent ones overlap, ⊕ keeps every hue one of those that went in.
Chuang, Weiskopf, Möller: Hue-Preserving Color Blending, IEEE TVCG 15(6), 2009.

    composite         stack of arrays (…, 4) -> array
    hue_add           c1 ⊕ c2 of colours (…, 3)
    hue_histogram     pixels (…, 4) -> how many have which hue
    stack_measures    what compositing arrays does to their hues, in numbers
    stack             layer files -> one file, as `hpcomp stack`
    StackOptions      all options of a stack, checked, for `stack` and its kin
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

from .version import __version__

if TYPE_CHECKING:
    from .analysis.check import CheckResult as CheckResult
    from .analysis.check import check as check
    from .analysis.explain import PixelExplanation as PixelExplanation
    from .analysis.explain import explain as explain
    from .analysis.hues import read_hues as read_hues
    from .analysis.palette import Palette as Palette
    from .analysis.palette import palette as palette
    from .blending.orders import ORDERS as ORDERS
    from .blending.porter_duff import OPERATORS as OPERATORS
    from .color.quantization import Losses as Losses
    from .color.spaces import SPACES as SPACES
    from .engine.arrays import composite as composite
    from .engine.arrays import hue_add as hue_add
    from .engine.arrays import stack_measures as stack_measures
    from .errors import ExitCode as ExitCode
    from .errors import HpcompError as HpcompError
    from .errors import HpcompWarning as HpcompWarning
    from .errors import InputError as InputError
    from .errors import InputWarning as InputWarning
    from .errors import MismatchError as MismatchError
    from .errors import OutputError as OutputError
    from .errors import SettingError as SettingError
    from .geometry import Window as Window
    from .imagefile.parts import ImageFile as ImageFile
    from .imagefile.reading import LayerImage as LayerImage
    from .jobs.batch import BatchResult as BatchResult
    from .jobs.batch import JobRecord as JobRecord
    from .jobs.batch import batch as batch
    from .jobs.frames import frame_jobs as frame_jobs
    from .jobs.jobfile import read_jobs as read_jobs
    from .jobs.jobfile import save_jobs as save_jobs
    from .jobs.schema import Job as Job
    from .layers.layerspec import LayerSpec as LayerSpec
    from .measures.histogram import HueHistogram as HueHistogram
    from .measures.histogram import hue_histogram as hue_histogram
    from .measures.labels import StackMeasures as StackMeasures
    from .options import StackOptions as StackOptions
    from .pipeline.flatten import flatten as flatten
    from .pipeline.images import info as info
    from .pipeline.images import read_layer as read_layer
    from .pipeline.images import write_image as write_image
    from .pipeline.picture import StackResult as StackResult
    from .pipeline.stack import stack as stack
    from .report.hueformats import write_hue_report as write_hue_report
    from .report.paletteformats import write_palette_report as write_palette_report

# Where each name lives; the imports above say the same to type checkers.
_HOME = {
    "BatchResult": ".jobs.batch",
    "JobRecord": ".jobs.batch",
    "batch": ".jobs.batch",
    "CheckResult": ".analysis.check",
    "check": ".analysis.check",
    "composite": ".engine.arrays",
    "hue_add": ".engine.arrays",
    "Losses": ".color.quantization",
    "ExitCode": ".errors",
    "HpcompError": ".errors",
    "HpcompWarning": ".errors",
    "InputError": ".errors",
    "InputWarning": ".errors",
    "MismatchError": ".errors",
    "OutputError": ".errors",
    "SettingError": ".errors",
    "PixelExplanation": ".analysis.explain",
    "explain": ".analysis.explain",
    "flatten": ".pipeline.flatten",
    "frame_jobs": ".jobs.frames",
    "Window": ".geometry",
    "HueHistogram": ".measures.histogram",
    "hue_histogram": ".measures.histogram",
    "ImageFile": ".imagefile.parts",
    "LayerImage": ".imagefile.reading",
    "read_hues": ".analysis.hues",
    "Job": ".jobs.schema",
    "read_jobs": ".jobs.jobfile",
    "save_jobs": ".jobs.jobfile",
    "StackMeasures": ".measures.labels",
    "stack_measures": ".engine.arrays",
    "ORDERS": ".blending.orders",
    "Palette": ".analysis.palette",
    "palette": ".analysis.palette",
    "StackOptions": ".options",
    "StackResult": ".pipeline.picture",
    "info": ".pipeline.images",
    "read_layer": ".pipeline.images",
    "stack": ".pipeline.stack",
    "write_image": ".pipeline.images",
    "OPERATORS": ".blending.porter_duff",
    "write_hue_report": ".report.hueformats",
    "write_palette_report": ".report.paletteformats",
    "SPACES": ".color.spaces",
    "LayerSpec": ".layers.layerspec",
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

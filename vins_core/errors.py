"""Everything that can go wrong because of what a user gave us, on one page.

Every message is one sentence that says what is wrong, where (file, topic, stamp or key), what was expected
and what to try.  The command line prints it and exits with code 2; the browser shows it in the page.
Expected trouble while estimating (a lost track, a rejected loop) is never an exception but an `Outcome`.
"""


class VinspectError(Exception):
    """Base of all errors a user can cause."""


class RecordingError(VinspectError):
    """A recording is missing, damaged, or lacks what the estimator needs (topics, overlap, images)."""


class CalibrationError(VinspectError):
    """A calibration or settings file is missing, incomplete or contradicts the recording."""


class ParameterError(VinspectError):
    """A parameter is unknown, of the wrong type or outside its range."""


class OutputError(VinspectError):
    """A file or folder cannot be written."""


class BackendError(VinspectError):
    """A back end was asked for that this machine cannot offer."""


class RunError(VinspectError):
    """A run record is missing, damaged beyond its last frame, or written by an incompatible version."""


class VocabularyError(VinspectError):
    """A vocabulary or its pattern file is missing, damaged, or belongs to other descriptors."""


class MapError(VinspectError):
    """A map is missing, damaged, of another camera, or written by an incompatible version."""

"""What other parameters would have done."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

WHAT_IF: Mapping[str, Tip] = {
    "whatif.gates": Tip(
        "gates judged again",
        "Every recorded value against the new limit, over the whole run, given the recorded trajectory: a verdict that "
        "flips would have changed everything after it, which only a fork shows.",
        source="SPEC 9.3a",
    ),
    "whatif.solve": Tip(
        "this frame again",
        "Repeated from the recorded state before it with the parameters as they stand; with its recorded tracks, or "
        "with its images tracked again.",
        source="SPEC 9.3b",
    ),
}

"""What the words of GPS fusion mean."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

GPS: Mapping[str, Tip] = {
    "gps": Tip(
        "GPS",
        "Holds the odometry to the earth. The odometry itself never feels the fixes, and loops do not enter here.",
        equation="z = p_e_b + R_e_o (R_o_b p_b_gps) + n,  n ~ N(0, R)",
        frame="e: east, north, up at the first fix that passed its gates",
        source="SPEC 8.2; seed 004, GPS",
    ),
    "gps.status": Tip(
        "status",
        "waiting: no fix has passed its own gates yet. aligning: fixes are kept until they show how the odometry's "
        "world is turned. fusing: fixes count.",
    ),
    "gps.yaw": Tip(
        "heading of the odometry",
        "By how much the odometry's world is turned about the vertical against east-north-up. It drifts with the "
        "odometry; the band is three standard deviations.",
        equation="turn(R_e_o)",
        unit="deg",
        source="SPEC 8.2; H6: VINS-Fusion starts it at 0",
    ),
    "gps.position": Tip(
        "position",
        "Standard deviation of the live position along its worst horizontal direction.",
        unit="m",
        frame="e",
    ),
    "gps.scale": Tip(
        "scale", "By what share the odometry is too short, with three standard deviations.", unit="percent"
    ),
    "gps.outage": Tip(
        "outage", "Time since the last fix that counted; the covariance grows with the way, not with time.", unit="s"
    ),
    "gps.live": Tip(
        "live trajectory",
        "Each pose as it was known right after its own frame, from the fixes up to then.",
        source="eval --trajectory global_live",
    ),
    "gps.final": Tip(
        "final trajectory",
        "All frames and all fixes in one problem, once the run has ended; dashed where no fix counts.",
        source="eval --trajectory global",
    ),
    "gps.fix": Tip(
        "fix",
        "What a receiver says of its antenna's place. Its verdict stays open as long as it is in the window: later "
        "fixes may agree or disagree with it.",
    ),
    "gps.fix.used": Tip("used", "Pulls at the trajectory."),
    "gps.fix.gated": Tip("gated", "Failed a gate of its own, or all others and the odometry disagree with it."),
    "gps.fix.open": Tip("kept for the alignment", "Passed its own gates, but fixes do not count yet."),
    "gps.antenna": Tip("antenna", "Where the fix puts the antenna.", unit="m", frame="e"),
    "gps.sigma": Tip("σ", "Standard deviation with which the fix is weighted.", unit="m", frame="e"),
    "gps.innovation": Tip(
        "innovation",
        "The fix minus where the odometry and the fixes before it expected the antenna, and how far off that may be.",
        equation="z − ẑ,   S = H P Hᵀ + R",
        unit="m",
        frame="e",
    ),
    "gps.alignment": Tip(
        "alignment",
        "What must hold before fixes count, and while they do: enough of them, a heading known well enough, and most "
        "of them in agreement. Otherwise it is made anew.",
        source="fusion/align.py",
    ),
    "gate.position_known": Tip("position known", "The place is a number, and a latitude."),
    "gate.stamp_is_new": Tip("stamp is new", "Of two fixes with one stamp the second does not count."),
    "gate.gps.max_chi2": Tip(
        "chi2",
        "How far a fix lies from where all others and the odometry put it, in units of how far it may.",
        equation="oᵀ (R + V)⁻¹ o,  without the fix itself",
        source="fusion/judge.py",
    ),
    "gate.gps.max_gap_s": Tip(
        "gap between frames",
        "Between the two frames on whose way the fix was taken. Not computed where no pose comes before it.",
        unit="s",
    ),
}

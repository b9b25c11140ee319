"""Device profiles: what drawing costs on a device, in nanoseconds."""

from dataclasses import dataclass

from farfield.errors import SettingsInvalid


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceProfile:
    """Coefficients of placement.md section 3, each an upper bound, nanoseconds, >= 0."""

    per_frame_ns: int  # everything a frame costs before anything is drawn, the impostors' batches included
    per_call_ns: float
    per_triangle_ns: float
    per_pixel_ns: float  # a pixel of an object's bounding area
    per_impostor_ns: float
    per_impostor_triangle_ns: float
    per_impostor_pixel_ns: float  # a pixel of an impostor layer, empty texels included


PROFILES = {
    "reference": DeviceProfile(
        per_frame_ns=1_000_000, per_call_ns=10_000.0, per_triangle_ns=5.0, per_pixel_ns=0.05,
        per_impostor_ns=1_000.0, per_impostor_triangle_ns=5.0, per_impostor_pixel_ns=0.05,
    ),
}  # fmt: skip


def find_profile(name: str) -> DeviceProfile:
    """Return the profile `name`. Raises SettingsInvalid."""
    if name not in PROFILES:
        raise SettingsInvalid("device", f"{name!r} is not a device profile; known: {', '.join(sorted(PROFILES))}")
    return PROFILES[name]

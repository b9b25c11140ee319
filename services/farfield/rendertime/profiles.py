"""Device profiles that need no measurement: what drawing costs, in nanoseconds, as rounded assumptions.

None of these was measured on a device. Each is a class of machine with figures on the slow side of it, so that a
placement for the class holds on most members; `farfield calibrate` (`fit.py`) makes a profile of one device.

coefficient  from                                  workstation   reference     laptop      phone
a call       the time a browser takes to check        5 us         10 us        15 us       40 us
             and pass on one WebGL draw call with
             its state; the processor decides
a triangle   1 / triangles a second, a quarter        2 ns          5 ns        10 ns       25 ns
             of what such devices are sold with      500 M         200 M       100 M        40 M
a pixel      1 / shaded, depth-tested pixels a     0.02 ns       0.05 ns       0.2 ns        1 ns
             second; memory traffic halves what       50 G          20 G         5 G         1 G
             is sold, shading halves it again
a frame      clear, compose, scripts, the            1 ms          1 ms         2 ms        3 ms
             impostors' batches
An impostor comes in a batch: a tenth of a call, the triangles and pixels of its layers as of any surface; blending and
the write of depth double its pixels where memory is slow (laptop, phone). `reference` is the profile that all figures
of the documentation refer to, and no device.
"""

from farfield.errors import SettingsInvalid
from farfield.settings import DeviceProfile, Settings

PROFILES = {
    "reference": DeviceProfile(
        per_frame_ns=1_000_000, per_call_ns=10_000.0, per_triangle_ns=5.0, per_pixel_ns=0.05,
        per_impostor_ns=1_000.0, per_impostor_triangle_ns=5.0, per_impostor_pixel_ns=0.05,
    ),
    "workstation": DeviceProfile(
        per_frame_ns=1_000_000, per_call_ns=5_000.0, per_triangle_ns=2.0, per_pixel_ns=0.02,
        per_impostor_ns=500.0, per_impostor_triangle_ns=2.0, per_impostor_pixel_ns=0.02,
    ),
    "laptop": DeviceProfile(
        per_frame_ns=2_000_000, per_call_ns=15_000.0, per_triangle_ns=10.0, per_pixel_ns=0.2,
        per_impostor_ns=1_500.0, per_impostor_triangle_ns=10.0, per_impostor_pixel_ns=0.4,
    ),
    "phone": DeviceProfile(
        per_frame_ns=3_000_000, per_call_ns=40_000.0, per_triangle_ns=25.0, per_pixel_ns=1.0,
        per_impostor_ns=4_000.0, per_impostor_triangle_ns=25.0, per_impostor_pixel_ns=2.0,
    ),
}  # fmt: skip


def find_profile(settings: Settings) -> DeviceProfile:
    """Return the profile of a job: the table `device_profile` where there is one, else the preset `device`.

    Raises SettingsInvalid.
    """
    if settings.device_profile is not None:
        return settings.device_profile
    if settings.device not in PROFILES:
        known = ", ".join(sorted(PROFILES))
        raise SettingsInvalid(
            "device",
            f"{settings.device!r} is not a device profile; known: {known}, or give the table device_profile of a "
            "fitted one (farfield calibrate)",
        )
    return PROFILES[settings.device]

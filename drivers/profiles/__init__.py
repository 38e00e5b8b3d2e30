"""The indicator profiles by name."""

from __future__ import annotations

from drivers.errors import IndicatorError
from drivers.profile import Profile
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A

PROFILES: dict[str, Profile] = {profile.name: profile for profile in (MITUTOYO_01A,)}


def profile_named(name: str) -> Profile:
    """The profile of this name. Raises IndicatorError listing what exists."""
    if name not in PROFILES:
        raise IndicatorError("indicator profile", repr(name), ", ".join(PROFILES))
    return PROFILES[name]

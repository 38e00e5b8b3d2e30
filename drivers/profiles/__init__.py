"""The indicators, one a file: what they are asked, what they answer, which of it is a number.

May import `drivers.profile` and the errors of `calib`.
"""

from __future__ import annotations

from calib.errors import UsageError
from drivers.profile import Profile
from drivers.profiles.ascii_line import ASCII_LINE
from drivers.profiles.cdi import CDI
from drivers.profiles.heidenhain_nd28x import HEIDENHAIN_ND28X
from drivers.profiles.keyence_dl_rs1a import KEYENCE_DL_RS1A
from drivers.profiles.magnescale_lt import MAGNESCALE_LT
from drivers.profiles.mahr_millimar import MAHR_C1202, MAHR_OPTORSD
from drivers.profiles.marposs_quick_read import MARPOSS_QUICK_READ
from drivers.profiles.metro_mux import METRO_MUX
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A, MITUTOYO_IT007R, MITUTOYO_MUX
from drivers.profiles.mitutoyo_counter import MITUTOYO_COUNTER, MITUTOYO_VL50
from drivers.profiles.mux import DMX, MUX
from drivers.profiles.starrett_iq import STARRETT_IQ
from drivers.profiles.sylvac import MAHR_MARCATOR, SYLVAC, SYLVAC_SIMPLEX
from drivers.profiles.tesa import TESA
from drivers.profiles.u_wave import U_WAVE

PROFILES: dict[str, Profile] = {
    profile.name: profile
    for profile in (
        ASCII_LINE,
        CDI,
        HEIDENHAIN_ND28X,
        KEYENCE_DL_RS1A,
        MAGNESCALE_LT,
        MAHR_MARCATOR,
        MAHR_C1202,
        MAHR_OPTORSD,
        MARPOSS_QUICK_READ,
        METRO_MUX,
        MITUTOYO_01A,
        MITUTOYO_IT007R,
        MITUTOYO_MUX,
        MITUTOYO_COUNTER,
        MITUTOYO_VL50,
        DMX,
        MUX,
        STARRETT_IQ,
        SYLVAC,
        SYLVAC_SIMPLEX,
        TESA,
        U_WAVE,
    )
}


def profile_named(name: str) -> Profile:
    """The profile of this name. Raises UsageError listing what exists."""
    if name not in PROFILES:
        raise UsageError("indicator profile", repr(name), ", ".join(PROFILES))
    return PROFILES[name]

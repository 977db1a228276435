"""Speed bounds of a press, by stiffness, delay and deceleration, so that a stop ends within the force limit."""

import math
from dataclasses import dataclass

REACTION_S = 0.12
"""From a reading that has arrived to a stage that begins to brake: look at the devices, line, stop byte, and motion
that the controller has already cut into steps (0.06 s in GRBL)."""

RISE, RISES = 0.1, 2.0
"""Over a step of a slow press the force may grow by this share of its limit, or so many times what it grew over the
step before. What grows more is a hard thing."""

FULL = 0.9
"""No stop may end above this share of the load cell's capacity."""


@dataclass(frozen=True)
class Reaction:
    """Delay and deceleration of a stop on one rig.

    Args:
        delay_s: from the force being there to the stage beginning to brake.
    """

    delay_s: float
    acceleration_mm_s2: float

    def overrun_mm(self, speed_mm_s: float) -> float:
        """Return the overrun of a stop in mm: v·T + v²/(2a)."""
        return speed_mm_s * self.delay_s + speed_mm_s**2 / (2.0 * self.acceleration_mm_s2)

    def fastest_mm_s(self, allowed_mm: float) -> float:
        """Return the speed whose overrun is `allowed_mm`."""
        a, t = self.acceleration_mm_s2, self.delay_s
        # Equal to a·(√(t² + 2·room/a) − t), without its cancellation.
        return 2.0 * max(0.0, allowed_mm) / (math.sqrt(t**2 + 2.0 * max(0.0, allowed_mm) / a) + t)


@dataclass(frozen=True)
class ForceBounds:
    """Force bounds that a stop guarantees on one rig.

    Args:
        reaction: how a stop comes about.
        limit_N: force above which a run is stopped.
        touch_N: force at which a search or an approach is.
        ceiling_N: force that no stop may end above.
        stiffest_N_mm: stiffness of the stiffest object that the stage may meet before contact.
    """

    reaction: Reaction
    limit_N: float
    touch_N: float
    ceiling_N: float
    stiffest_N_mm: float

    @property
    def free_mm_s(self) -> float:
        """Largest speed on a path that should be free: an obstacle stops the stage at `touch_N`."""
        return self.detected_mm_s(self.touch_N)

    @property
    def unknown_mm_s(self) -> float:
        """Largest speed before this unit was pressed, for any stiffness that it may have."""
        return self.detected_mm_s(self.limit_N)

    def detected_mm_s(self, force_N: float) -> float:
        """Fastest speed where a hard stop may lie that is noticed at this force."""
        return self.reaction.fastest_mm_s((self.ceiling_N - force_N) / self.stiffest_N_mm)

    def rise_N(self, last_N: float) -> float:
        """Return the allowed rise of the force over the next step of a slow press, after `last_N` over the last."""
        return max(RISE * self.limit_N, RISES * last_N)

    def probed_mm_s(self, force_N: float, stiffness_N_mm: float) -> float:
        """Fastest speed where this unit showed at most this force and this stiffness."""
        return self.reaction.fastest_mm_s((self.ceiling_N - force_N) / max(stiffness_N_mm, 1e-6))

    def ahead_mm(self, speed_mm_s: float, force_N: float) -> float:
        """Return how far ahead, in mm, a controller may have commands before the onset of contact.

        A host that dies before it has noticed `force_N` then leaves no more than the ceiling.
        """
        unseen_s = self.reaction.delay_s - REACTION_S
        return (self.ceiling_N - force_N) / self.stiffest_N_mm - speed_mm_s * unseen_s

    def host_loss_N(self, speed_mm_s: float, ran_on_mm: float) -> float:
        """Return the force at most where the host dies at the limit: unseen, and what runs out."""
        unseen_s = self.reaction.delay_s - REACTION_S
        return self.limit_N + self.stiffest_N_mm * (speed_mm_s * unseen_s + ran_on_mm)

    def worst_N(self, speed_mm_s: float, force_N: float, stiffness_N_mm: float) -> float:
        """Return the force a stop ends at, at most, when the force is noticed at `force_N`."""
        return force_N + stiffness_N_mm * self.reaction.overrun_mm(speed_mm_s)

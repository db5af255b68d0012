"""From paths to sound: tracks, the plan, and the two engines that carry it out."""

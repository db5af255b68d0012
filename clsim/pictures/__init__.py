"""Pictures and pages of plain values: what they show comes from above."""

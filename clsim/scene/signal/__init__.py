"""What sources are driven with."""

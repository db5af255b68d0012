"""Delay and gain over time of every path, whoever computed them."""

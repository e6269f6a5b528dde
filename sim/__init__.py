"""The simulated remote site and the measurement of the product against its truth."""

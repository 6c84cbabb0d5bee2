"""A page on which a flow runs live beside itself without control, driven by hand or by a controller."""

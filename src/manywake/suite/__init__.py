"""The flows that are shipped, one file each with its data beside it, and how any case is loaded."""

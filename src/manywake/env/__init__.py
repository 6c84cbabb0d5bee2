"""Flows under control: actions become amplitudes, readings become rewards; and the Gymnasium environments."""

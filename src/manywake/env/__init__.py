"""The control task on a flow, and its Gymnasium environments."""

"""The paper's figures, rerun: python -m experiments NAME, or manywake figure NAME. One module a figure."""

"""The command line: manywake validate | baseline | train | resume | evaluate | replay | figure | bench."""

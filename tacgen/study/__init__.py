"""Tables of trained networks: datasets, runs and tests of every row of a study."""

# The installed program knows its own commands.
lenslet-studio completions fish | source

# The installed program knows its own commands.
eval "$(lenslet-studio completions bash)"

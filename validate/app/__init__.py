"""The program that a person starts: commands, their output in the terminal, the workbench."""

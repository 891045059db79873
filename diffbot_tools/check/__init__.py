"""The command ``diffbot check``: observe a running robot and print one line for each input, output and node."""

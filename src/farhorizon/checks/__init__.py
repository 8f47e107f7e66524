"""Questions about a set-up before it runs: is it stable, what does it reflect, what does it cost."""

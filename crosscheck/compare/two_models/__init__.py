"""Two models of one mechanism against each other, by newton_euler's equations of each."""

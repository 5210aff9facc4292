"""What real processes bear and cost: crowded skies, many runs, rates in real time, clients that watch, old tracks."""

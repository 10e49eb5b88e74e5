"""What a benchmark's scores say: gains, aggregates with intervals, leaderboards."""

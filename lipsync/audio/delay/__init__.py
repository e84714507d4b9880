"""How much later than it says sound leaves a loudspeaker: clicks out, a microphone in."""

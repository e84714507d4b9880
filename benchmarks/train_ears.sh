#!/bin/sh
# The recogniser's training in stages (docs/decisions/0076-hours-of-training.md).
#   benchmarks/train_ears.sh STAGE CORPORA RUNS
# CORPORA holds librispeech, speechocean762 and picovoice_commands; RUNS keeps every stage's folder.
# A stage that was stopped (Ctrl-C, SIGTERM, a power cut) goes on when the same line is given again.
set -eu
STAGE=$1 CORPORA=$2 RUNS=$3
HELD="benchmarks/speakers/librispeech_scored.csv,benchmarks/speakers/speechocean762_scored.csv,benchmarks/speakers/speechocean762_scored_new.csv,benchmarks/speakers/picovoice_commands_scored.csv"
VALIDATION="benchmarks/speakers/validation.csv"
VOICES="espeak:en-us,espeak:en,flite:awb,flite:kal,festival:ked,espeak:de,espeak:fr,espeak:es"
PAST="1,2,4,8,1,2,4,8,16,32"

# Alignments are made once, by the first stage; each stage has its own folder.
mkdir -p "$RUNS/$STAGE"
for kept in alignments.jsonl synthetic; do
    if [ -e "$RUNS/small/$kept" ] && [ ! -e "$RUNS/$STAGE/$kept" ]; then
        cp -r "$RUNS/small/$kept" "$RUNS/$STAGE/$kept"
    fi
done

learn() {
    # One line, so that a test can read what it holds out.
    lipservo learn recognizer "$CORPORA/librispeech" "$CORPORA/speechocean762" "$CORPORA/picovoice_commands" --folder "$RUNS/$STAGE" -o "$RUNS/$STAGE.npz" --held-out "$HELD" --validation "$VALIDATION" --synthetic "$VOICES" --resume --nice 19 "$@"
    lipservo learn plot "$RUNS/$STAGE/log.jsonl" -o "$RUNS/$STAGE.png"
}

case $STAGE in
# Compared at 2,500 steps each, all from the default weights.
small) learn --start-from default --steps 2500 --rate 1.2e-3 --copies 3 ;;
seen) learn --start-from default --steps 2500 --rate 1.2e-3 --copies 3 --visible-weight 0.1 ;;
past) learn --start-from default --steps 2500 --rate 1.2e-3 --copies 3 --dilations "$PAST" ;;
wide) learn --start-from default --steps 2500 --rate 1.2e-3 --copies 3 --dilations "$PAST" --channels 256 ;;
# The teacher, two rounds.
teacher1) learn --delays 60 --dilations "$PAST" --channels 384 --steps 6000 --rate 2e-3 --copies 5 ;;
teacher2) learn --delays 60 --start-from "$RUNS/teacher1.npz" --teacher "$RUNS/teacher1.npz" --steps 3000 --rate 1e-3 --copies 5 ;;
# What ships: the shape that won above (here: wide), taught.
student) learn --start-from "$RUNS/wide.npz" --teacher "$RUNS/teacher2.npz" --visible-weight 0.1 --steps 25000 --rate 2e-3 --copies 10 ;;
*) echo "$STAGE: no stage; small seen past wide teacher1 teacher2 student" >&2; exit 2 ;;
esac

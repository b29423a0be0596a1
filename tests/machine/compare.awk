# Two tables of `wingd export --format csv`: fails where a number of the second is further from the first's than a
# hundredth of its standard deviation, a standard deviation is further off than a hundredth of itself, or a word differs.
BEGIN { FS = "," }
{
    while (match($0, /"[^"]*"/)) { # commas within words
        text = substr($0, RSTART + 1, RLENGTH - 2); gsub(/,/, ";", text)
        $0 = substr($0, 1, RSTART - 1) text substr($0, RSTART + RLENGTH)
    }
}
FNR == 1 {
    for (i = 1; i <= NF; i++) { name[i] = $i; column[$i] = i }
    for (i = 1; i <= NF; i++) {
        if ($i ~ /(^|_)sigma_/) { own[i] = 1; value = $i; sub(/sigma_/, "", value); if (value in column) sigma[column[value]] = i }
        # In pixels, as the image point's; the other numbers are free of units and count as they are.
        if ($i ~ /^(residual|mdb)_/) { value = $i; sub(/^[a-z]*/, "sigma", value); sigma[i] = column[value] }
    }
}
FNR == NR { first[FNR] = $0; rows++; next }
{
    split(first[FNR], one)
    for (i = 1; i <= NF; i++) {
        if (one[i] !~ /^-?[0-9.]+(e-?[0-9]+)?$/ || $i !~ /^-?[0-9.]+(e-?[0-9]+)?$/) {
            if (one[i] "" == $i "") continue
            words++; print "row " FNR ", " name[i] ": " one[i] ", " $i > "/dev/stderr"
            continue
        }
        unit = own[i] ? one[i] : (i in sigma) ? one[sigma[i]] : 1
        off = $i - one[i]; if (off < 0) off = -off
        if (off > 0) off = unit > 0 ? off / unit : 1
        if (own[i]) { sigmas++; if (off > most_own) most_own = off }
        else if (!(i in sigma)) { if (off > most_other) most_other = off }
        else { values++; if (off > most) { most = off; where = " (" name[i] ")" } }
    }
}
END {
    printf "%d values in %d rows differ by at most %.1e standard deviations%s, ", values, rows - 1, most, where
    printf "%d standard deviations by %.1e of themselves, other numbers by %.1e; %d words differ\n", sigmas, most_own, most_other, words
    exit !(values > 1000 && FNR == rows && most <= 0.01 && most_own <= 0.01 && most_other <= 0.01 && words == 0)
}

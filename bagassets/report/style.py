"""Style and script of the pages; nothing is loaded from the network."""

MAP_CSS = """
.gridmap{width:100%;border:1px solid #d8dad4}
.gridmap polyline{fill:none;stroke-width:2.5;stroke-linejoin:round;stroke-linecap:round;opacity:.85}
.gridmap polyline:hover,.gridmap polyline.on{stroke-width:7;opacity:1}.gridmap .g{stroke:#dfe2da;stroke-width:1}
.gridmap text{font:12px system-ui,sans-serif;fill:#666}.gridmap circle.on{r:9}
.gridmap .name{font-size:11px;paint-order:stroke;stroke:#f4f5f2;stroke-width:3px}
.legend{display:flex;flex-wrap:wrap;gap:.2rem 2rem;font:14px system-ui,sans-serif;margin:.4rem 0}.legend summary{cursor:pointer}
.legend [data-way]{cursor:default;overflow-wrap:anywhere}.legend [data-way]:hover{text-decoration:underline}
"""

# Pointing at a name in the legend shows whose line it is, where many lie upon each other.
LEGEND_SCRIPT = """
document.querySelectorAll('.legend [data-way]').forEach(name=>['mouseenter','mouseleave'].forEach(kind=>
name.addEventListener(kind,()=>document.querySelectorAll('.gridmap [data-way]').forEach(way=>
way.classList.toggle('on',kind=='mouseenter'&&way.dataset.way==name.dataset.way)))));
"""

PAGE_CSS = (
    """
:root{color-scheme:light}body{font:15px/1.5 system-ui,sans-serif;color:#22252a;background:#fff;margin:2rem auto;
max-width:1320px;padding:0 1.2rem}h1{font-size:1.7rem;margin:.2rem 0}h2{font-size:1.15rem;margin:2rem 0 .5rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{padding:.28rem .35rem;text-align:left;
border-bottom:1px solid #e6e8e4;vertical-align:top}th{font-weight:600;background:#f4f5f2;cursor:pointer;white-space:nowrap}
td:first-child,td:last-child,td.k{overflow-wrap:anywhere}
td:first-child{min-width:15rem}#recordings td:first-child{min-width:6rem}td.n,th.n{text-align:right;white-space:nowrap}.cards{display:flex;flex-wrap:wrap;gap:.6rem;margin:1rem 0}.card{background:#f4f5f2;
border-radius:6px;padding:.5rem .9rem;min-width:6.5rem}.card b{display:block;font-size:1.3rem}.card span{color:#667}
.t{width:96px;height:auto;border-radius:3px;display:block}.p{max-width:49%;height:auto;
vertical-align:top;border-radius:4px;margin:.3rem .3rem .3rem 0}
.ready{color:#217a43}.ready,.failed,.skipped,.stale,.copy{white-space:nowrap}.copy{color:#777}.failed{color:#b3261e;font-weight:600}.skipped{color:#777}.stale{color:#a15c00}
button{font:inherit;color:#2f5fa8;background:none;border:0;padding:0;cursor:pointer}[popover]{max-width:1000px;
width:90vw;max-height:90vh;overflow:auto;border:1px solid #ccc;border-radius:8px;padding:0 1.2rem 1.2rem}
.dim{color:#667}input{font:inherit;padding:.25rem .5rem;width:18rem;margin:.2rem 0 .6rem}
code{background:#f4f5f2;padding:0 .25em;border-radius:3px;overflow-wrap:anywhere}
@media (max-width:900px){body{margin:1rem auto}table{display:block;overflow-x:auto}td{min-width:3rem}}
"""
    + MAP_CSS
)

TABLE_SCRIPT = """
const table=document.querySelector('#recordings'),body=table&&table.tBodies[0];
if(table){table.tHead.querySelectorAll('th').forEach((th,i)=>th.addEventListener('click',()=>{
const down=th.dataset.down!=='1';th.dataset.down=down?'1':'0';
const value=r=>{const c=r.cells[i];return c.dataset.v!==undefined?+c.dataset.v:c.innerText.toLowerCase()};
[...body.rows].sort((a,b)=>{const x=value(a),y=value(b);return (x>y?1:x<y?-1:0)*(down?1:-1)})
.forEach(r=>body.append(r))}));
document.querySelector('#filter').addEventListener('input',e=>{const w=e.target.value.toLowerCase();
[...body.rows].forEach(r=>r.hidden=!r.innerText.toLowerCase().includes(w))})}
"""
